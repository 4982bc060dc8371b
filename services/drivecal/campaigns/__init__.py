"""Campaigns: resolved from a specification, worked through stage by stage, their cells tracked, their results read."""

"""Campaigns: resolved from a specification, run stage by stage, with tracked cells and readable results."""

"""Removal of campaigns, whose runs stay."""

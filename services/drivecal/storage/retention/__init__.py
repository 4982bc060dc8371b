"""Removal of old campaigns' cells and runs that nothing refers to."""

"""Backup, restore, checks and statistics of a whole database."""

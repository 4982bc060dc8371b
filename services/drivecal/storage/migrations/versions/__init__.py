"""Revisions of the database, a module each."""

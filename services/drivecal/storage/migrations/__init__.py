"""Alembic's environment and the revisions of the database, packaged so that every installation can upgrade."""

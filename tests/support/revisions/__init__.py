"""Rows of databases of earlier revisions, made by the code of their releases."""

"""A small typed client of the REST API; the command line and the demo are built on it."""

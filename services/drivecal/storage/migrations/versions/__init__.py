"""One module per revision of the database, oldest first."""

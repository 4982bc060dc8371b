"""The database of drivecal: SQLAlchemy Core tables, their migrations, and one module of functions per noun that take a Connection."""

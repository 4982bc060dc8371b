"""The database itself: connections, schema, types, locks, errors."""

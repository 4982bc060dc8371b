"""The built-in scenario catalogue."""

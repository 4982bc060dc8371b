"""What the system's kernel forbids a user's simulator. Standard library only: the keeper imports it."""

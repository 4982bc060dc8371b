"""Rules and filters by which the kernel confines a user's simulator. Standard library only: the keeper imports it."""

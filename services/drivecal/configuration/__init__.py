"""Configuration of the coordinator's processes, and the files that users write."""

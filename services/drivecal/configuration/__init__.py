"""Configuration of the coordinator's processes."""

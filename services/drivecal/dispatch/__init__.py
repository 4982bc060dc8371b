"""The dispatcher process, which runs campaigns."""

"""The backend on Ray actors, its cluster and its nodes."""

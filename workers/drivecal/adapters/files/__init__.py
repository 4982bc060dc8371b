"""Files of simulators: their limits and their removal. Standard library only: the keeper imports `removal`."""

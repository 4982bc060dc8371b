"""Files that simulators leave: how much they take, and their removal. Standard library only: the keeper imports it."""

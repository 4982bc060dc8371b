"""A user's controller in SUMO's traffic on a corridor: the child process of the simulator kind `highway`."""

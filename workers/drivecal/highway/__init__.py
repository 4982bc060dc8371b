"""Simulator `highway`: a vehicle with a user's controller in SUMO's traffic on a road network. Runs in a child process, see `driver`."""

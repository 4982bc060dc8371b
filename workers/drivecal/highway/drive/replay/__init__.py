"""Replays of runs: the roads near the drive as polylines, and the vehicles on them."""

"""The driving function to calibrate: a sampling planner in the Frenet frame."""

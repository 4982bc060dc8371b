"""The built-in driving function: a sampling planner in the Frenet frame."""

"""A run from start to rating: planner, vehicle and traffic in a closed loop."""

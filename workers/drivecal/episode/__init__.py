"""One run from start to rating: planner, vehicle and traffic in closed loop."""

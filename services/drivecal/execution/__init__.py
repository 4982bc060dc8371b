"""Gets cells simulated: which are sent next, to whom, and what becomes of those that broke down. `ray_backend` reaches the workers."""

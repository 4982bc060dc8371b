"""Everything of the motorway: the built-in problem, and the child process of the simulator kind `highway`. Nothing else imports it."""

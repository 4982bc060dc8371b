"""Simulators of users in child processes: programs that answer JSON lines, commands, Python functions and FMUs."""

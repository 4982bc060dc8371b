"""Sensitivity analysis, pure: radial designs on the grid, elementary effects, complexity reduction, as ask/tell in phases."""

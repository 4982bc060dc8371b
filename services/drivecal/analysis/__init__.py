"""Studies of a campaign's results: robustness, validation, groups of equal optima, convergence, comparisons. Pure: no I/O."""

"""The paper's studies of what was found: robustness, validation, groups of equal optima, convergence. Pure: no I/O."""

"""Comparisons of optimizers and reductions: resolving, running and reading them."""

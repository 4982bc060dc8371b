"""Comparisons of optimizers and reductions: resolved into runs, carried out, and read."""

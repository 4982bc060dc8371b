"""Execution of cells: order, choice of workers, retries."""

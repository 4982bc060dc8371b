"""Execution of cells: which are sent next, to which worker, and what becomes of those that broke down."""

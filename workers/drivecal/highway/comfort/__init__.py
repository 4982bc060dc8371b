"""Comfort of a run: metrics of its time series, and the evaluators that rate it."""

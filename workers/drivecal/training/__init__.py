"""Training of the learned parts: `python -m drivecal.training` (`make train`). No other package imports it."""

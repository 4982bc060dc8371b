"""Training of the learned parts: `python -m drivecal.highway.training` (`make train`). No other package imports it."""

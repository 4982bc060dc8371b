"""Makes the learned parts anew: `python -m drivecal.training` (`make train`). Nothing that runs imports it."""

"""Code of a worker process, which runs batches of cells and returns plain results."""

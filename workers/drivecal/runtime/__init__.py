"""What runs in a worker process: batches of cells in, plain results out."""

"""Problem bundles: a folder with `problem.yaml` and its files, and what follows from its content (`manifest`)."""

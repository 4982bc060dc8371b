"""Problem bundles: a folder with `problem.yaml` and its files.

`manifest` and `checks` define and check `problem.yaml`. `expressions` has formulas and constraints. `archives` packs and unpacks bundles,
and computes digests. `fingerprints` lists all inputs of a run and of a score.
"""

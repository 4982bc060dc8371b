"""Problem bundles: a folder with `problem.yaml` and its files, and what follows from its content.

`manifest` and `checks`: the content of `problem.yaml`; `expressions`: formulas and constraints; `archives`: packing, unpacking and
digests; `fingerprints`: what decides a run and a score; `scoring`: scores of runs.
"""

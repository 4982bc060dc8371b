"""Evaluates parameter sets in this process, without a server and without Ray.

>>> from drivecal import local
>>> calm = {"P1": 11, "P2": 0.04, "P3": 174, "P4": 1692, "P5": 153, "P6": 0.67}
>>> calm |= {"P7": 73, "P8": 195, "P9": 5.8, "P10": 9.9, "P11": 164}
>>> result = local.evaluate(calm, "S1")
>>> result.objective
7.0
>>> result.cells["S1"].failure is None
True

A problem of yours runs the same way: `local.evaluate(parameters, problem="my-brake")`.
"""

from drivecal.local.evaluation import LocalEvaluation, SimulatedCell, evaluate

__all__ = ["LocalEvaluation", "SimulatedCell", "evaluate"]

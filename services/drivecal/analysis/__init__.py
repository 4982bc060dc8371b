"""Studies of a campaign's results: robustness, validation, groups of equal optima, convergence, comparisons. Pure: no I/O.

>>> import numpy as np
>>> from drivecal.analysis import best_at, regions, to_nearest
>>> best = np.array([[0.10, 0.10], [0.12, 0.11], [0.90, 0.80]])  # sets with the best objective, in the unit cube
>>> regions(best).tolist()
[0, 0, 1]
>>> [round(distance, 2) for distance in to_nearest(best, np.array([[0.5, 0.5]]))]  # to the nearest worse set
[0.4, 0.39, 0.35]
>>> best_at([4.0, 5.0] + [5.6] * 12)  # the iteration, counted from 1, in which the best solution was found
3
"""

from drivecal.analysis.convergence import best_at, converged_at
from drivecal.analysis.optima import regions, to_nearest
from drivecal.analysis.savings import account
from drivecal.analysis.solutions import Ranking
from drivecal.analysis.trust import Evidence
from drivecal.analysis.verdicts import sentence

__all__ = ["Evidence", "Ranking", "account", "best_at", "converged_at", "regions", "sentence", "to_nearest"]

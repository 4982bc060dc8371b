"""Statistics of elementary effects (Morris 1991; Campolongo et al. 2007)."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan, sqrt

import numpy as np

from drivecal.plugins.ports import Floats


@dataclass(frozen=True, slots=True)
class EffectStatistics:
    """Statistics of r elementary effects of a parameter: mean, mean of magnitudes, standard deviation, and number.

    Fewer than two effects have no standard deviation: all figures are NaN then.
    """

    mu: float
    mu_star: float
    sigma: float
    n_effects: int

    @property
    def s_rel(self) -> float:
        """The relative sensitivity sqrt(mu^2 + sigma^2), which is about the root mean square of the effects."""
        return sqrt(self.mu**2 + self.sigma**2)


def measures(effects: Floats) -> EffectStatistics:
    """Returns the statistics of an analysis' effects, shape (r,); NaN effects of failed runs do not count."""
    known = effects[~np.isnan(effects)]
    if known.size < 2:
        return EffectStatistics(nan, nan, nan, known.size)
    mean, magnitude = float(known.mean()), float(np.abs(known).mean())
    return EffectStatistics(mean, magnitude, float(known.std(ddof=1)), known.size)


def smallest_nonzero(statistics: Sequence[EffectStatistics]) -> float | None:
    """The smallest s_rel that is not zero, None if all are: with few samples a threshold below it means any change at all."""
    return min((effect.s_rel for effect in statistics if effect.s_rel > 0), default=None)

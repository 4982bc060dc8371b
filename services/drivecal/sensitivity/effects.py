"""Elementary effects and their statistics for a parameter (Section II-A of the paper, Equations 1 and 2)."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan, sqrt

import numpy as np
import numpy.typing as npt

from drivecal.domain.parameters import Indices
from drivecal.domain.scales import COMFORT

Floats = npt.NDArray[np.float64]
Unordered = npt.NDArray[np.bool_]
"""Parameters that are choices, shape (n_searched,)."""


@dataclass(frozen=True, slots=True)
class Design:
    """Points to run and which two of them make each elementary effect.

    `points`: grid indices, shape (n, n_searched). `first`, `second`: rows of `points`, and `steps`: the signed step from one to the
    other in units of the parameter's full range, never 0; all of one shape, whose last axis is the samples. A change between choices, which
    have no order, is a step of the full range. Parameters with fewer intervals than others have NaN steps in the rest.
    """

    points: Indices
    first: Indices
    second: Indices
    steps: Floats

    def effects(self, scores: Floats, span: float = COMFORT.span) -> Floats:
        """Elementary effects, shaped as `steps`, from the points' scores, shape (n,); NaN if one of the two runs failed.

        Changes of the score are divided by the `span` of its scale: an effect of 1 is the whole scale over the whole range.
        """
        changes: Floats = (scores[self.second] - scores[self.first]) / span
        return changes / self.steps


class DesignBuilder:
    """Collects the points and pairs of a design."""

    def __init__(self, n_values: Indices, unordered: Unordered | None = None) -> None:
        """`n_values`: grid sizes of the searched parameters; `unordered`: which of them are choices; shape (n_searched,)."""
        self._n_values = n_values
        self._unordered = np.zeros(len(n_values), dtype=np.bool_) if unordered is None else unordered
        self._points: list[Indices] = []
        self._pairs: list[tuple[int, Indices, Indices]] = []
        self._count = 0

    def add_points(self, points: Indices) -> Indices:
        """Adds runs, shape (n, n_searched); gives their row numbers, shape (n,)."""
        rows = np.arange(self._count, self._count + len(points))
        self._points.append(points)
        self._count += len(points)
        return rows

    def add_pairs(self, column: int, first: Indices, second: Indices) -> None:
        """Adds one analysis of r effects of the parameter in `column`: pairs of rows, shape (r,), that differ only in that column."""
        self._pairs.append((column, first, second))

    def add_gaps(self, column: int, samples: int, count: int) -> None:
        """Adds `count` analyses without effects, in place of intervals that the parameter in `column` does not have."""
        nothing = np.zeros(samples, dtype=np.int64)
        self._pairs += [(column, nothing, nothing)] * count

    def design(self, *shape: int) -> Design:
        """The design, its analyses in the order in which they were added, shaped (*shape, r)."""
        points = np.concatenate(self._points)
        points.flags.writeable = False  # scenarios share them, and effects are computed from them later
        first = np.stack([pair for _, pair, _ in self._pairs])
        second = np.stack([pair for _, _, pair in self._pairs])
        columns = np.array([column for column, _, _ in self._pairs])[:, np.newaxis]
        moves = points[second, columns] - points[first, columns]
        steps = np.where(self._unordered[columns], np.sign(moves), moves / (self._n_values[columns] - 1))
        steps[first == second] = np.nan
        full = (*shape, first.shape[-1])
        return Design(points, first.reshape(full), second.reshape(full), steps.reshape(full))


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

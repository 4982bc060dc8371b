"""The merit of sets: a number for each, with any number of objectives and constraints on results."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from drivecal.domain.parameters import Indices
from drivecal.domain.rounding import grain, grains
from drivecal.plugins.ports import Floats
from drivecal.plugins.search import Aim

AUGMENTATION = 0.05
"""Weight of the sum, which is added to the largest distance, so that every objective counts (Knowles 2006, ParEGO)."""
REACH = 0.6
"""Distance beyond the front's best values, in its ranges, that half of the sets aim at: else no set would seek a further end."""


@dataclass(frozen=True)
class Standing:
    """The judged complete sets: objectives, shape (n, m), and violations, shape (n,), without sets that lack a result."""

    objectives: Floats
    violations: Floats

    @classmethod
    def of(cls, aim: Aim, values: Floats) -> "Standing":
        """Judges the values of complete sets, shape (n, n_scenarios, n_values)."""
        objectives, violations = aim.judge(values) if len(values) else (np.empty((0, aim.objectives)), np.empty(0))
        valid = np.isfinite(objectives).all(axis=1) & np.isfinite(violations)
        return cls(objectives[valid], violations[valid])

    @cached_property
    def front(self) -> tuple[Floats, Floats]:
        """The best and the worst value of each objective on the front of the sets that keep all constraints, or else of all sets, shape
        (m,); the worst of all of them if the front has one value. Sets behind it may be worse by any amount, such as a failed run's."""
        kept = self.objectives[self.violations <= 0]
        points = kept if len(kept) else self.objectives
        if not len(points):
            return np.zeros(points.shape[1]), np.zeros(points.shape[1])
        best = points.max(axis=0)
        if len(best) == 1:
            return best, points.min(axis=0)
        as_good = points[:, np.newaxis] >= points
        dominated = (as_good.all(axis=2) & ~as_good.transpose(1, 0, 2).all(axis=2)).any(axis=0)
        worst = points[~dominated].min(axis=0)
        return best, np.where(worst < best, worst, points.min(axis=0))

    def beats(self, objectives: Floats, violations: Floats) -> npt.NDArray[np.bool_]:
        """Returns which of k sets with such bounds cannot be better than all complete sets, shape (k,); NaN is no bound."""
        own, bounds = violations[:, np.newaxis], objectives[:, np.newaxis]
        less = self.violations < own - grains(self.violations, own)
        as_much = self.violations <= own + grains(self.violations, own)
        as_good = np.all(self.objectives >= bounds - grains(self.objectives, bounds), axis=2)
        beaten: npt.NDArray[np.bool_] = np.any(less | (as_much & as_good), axis=1)
        return beaten


class Merit:
    """A number for each set, higher is better: the objective, or several as one, in units of the front's ranges.

    Several are weighted by a direction, and the largest distance to the best of all counts. Sets that violate constraints are worse than
    all others, by their violations.
    """

    def __init__(self, aim: Aim, standing: Standing, direction: Floats, reach: float = 0.0) -> None:
        """`direction`: positive weights of the objectives, shape (m,), sum 1. `reach`: distance, in the front's ranges, of the aimed values
        beyond the best ones of the front."""
        self._aim, self._direction = aim, direction
        self.noise = 0.0
        """Deviation of the merit of a single answer in each scenario."""
        self.least_gain = 0.0
        """Gain from which on a set counts as an improvement."""
        best, lowest = standing.front
        self._span = np.where(best > lowest, best - lowest, 1.0)
        self._ideal = best + reach * self._span
        known = self._scalar(standing.objectives)
        self._floor = float(known.min()) if len(known) else 0.0
        self.unit = float(np.ptp(known)) if len(known) and np.ptp(known) > 0 else 1.0
        """Range of the merits of the complete sets."""
        self._worst = float(standing.violations.max(initial=0.0)) or 1.0
        self.best = float(self._with_violations(known, standing.violations).max()) if len(known) else -np.inf
        """Merit of the best complete set."""

    def __call__(self, values: Floats) -> Floats:
        """Returns the merits of values, shape (n, n_scenarios, n_values); without a result negative infinity."""
        objectives, violations = self._aim.judge(values)
        merits = self._with_violations(self._scalar(objectives), violations)
        return np.where(np.isnan(merits) | np.isnan(violations), -np.inf, merits)

    def _scalar(self, objectives: Floats) -> Floats:
        if self._aim.objectives == 1:
            return objectives[:, 0]
        away = self._direction * (self._ideal - objectives) / self._span
        result: Floats = -away.max(axis=1) - AUGMENTATION * away.sum(axis=1)
        return result

    def _with_violations(self, merits: Floats, violations: Floats) -> Floats:
        return np.where(violations > 0, self._floor - self.unit * (1.0 + violations / self._worst), merits)

    def improvements(self, merits: Floats) -> Floats:
        """Returns expected improvements by draws, shape (n_draws, n); without a complete set the mean merits. Of samples, less is learned
        the less they say (Huang et al. 2006, augmented expected improvement)."""
        finite = np.where(np.isfinite(merits), merits, -1e300)
        if np.isneginf(self.best):
            return np.asarray(finite.mean(axis=0))
        result: Floats = np.maximum(finite - self.best - self.least_gain, 0.0).mean(axis=0)
        if self.noise > 0:
            result = result * (1.0 - self.noise / np.hypot(self.noise, _mean_and_spread(merits)[1]))
        return result

    def best_first(self, merits: Floats) -> Indices:
        """Returns the places of sets by their expected improvement, the largest first, shape (n,).

        In a search that stands still no draw improves on the best set. Then mean plus deviation counts (an upper confidence bound, Srinivas
        et al. 2010), which takes one neighbour of the best set after the other; or, where a least gain is wanted, the probability of it, by
        the deviations that the mean misses it by (Kushner 1964). Sets that probably fail come last.

        Args:
            merits: Draws, shape (n_draws, n).
        """
        mean, spread = _mean_and_spread(merits)
        chances = mean + spread
        if self.least_gain > 0:
            chances = (mean - self.best - self.least_gain) / np.maximum(spread, 1e-9 * self.unit)
        chances = np.where(2 * np.isfinite(merits).sum(axis=0) > len(merits), chances, -np.inf)
        order: Indices = np.lexsort((-chances, -self.improvements(merits)))
        return order

    def beaten_by(self, merits: Floats) -> float:
        """Returns the share of merits that are better than the best set's by more than rounding."""
        return float((merits > self.best + (grain(self.best) if np.isfinite(self.best) else 0.0)).mean())


def _mean_and_spread(merits: Floats) -> tuple[Floats, Floats]:
    """Returns means and deviations of the draws with a result, shape (n,); 0 without one."""
    valid = np.isfinite(merits)
    count = np.maximum(valid.sum(axis=0), 1)
    mean = np.where(valid, merits, 0.0).sum(axis=0) / count
    return mean, np.sqrt(((np.where(valid, merits, mean) - mean) ** 2).sum(axis=0) / count)

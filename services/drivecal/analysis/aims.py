"""Aims of searches by the cell: the weighted score of a campaign, or its objectives and constraints on results. Pure."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from drivecal.analysis.goals import SCORE, Bound, Goal, Goals, Objective, weighted
from drivecal.domain.constraints import Columns
from drivecal.domain.evaluations import CellScore
from drivecal.domain.scales import Scale
from drivecal.plugins.ports import Floats


def _better_end(scale: Scale, sign: int) -> float:
    return scale.upper if sign > 0 else scale.lower


@dataclass(frozen=True)
class WeightedScore:
    """The weighted mean of the score (Eq. 6). The value of a cell is its continuous rating, which is rounded to the scale's steps."""

    weights: Mapping[str, float]
    """By scenario, of sum 1; a scenario of weight 0 may be without a value."""
    scale: Scale
    values: int = 1
    objectives: int = 1

    @property
    def scenarios(self) -> int:
        """Number of scenarios."""
        return len(self.weights)

    @cached_property
    def best(self) -> Floats:
        """The better end of the usual range."""
        return np.full((self.scenarios, 1), _better_end(self.scale, self.scale.sign))

    @cached_property
    def worst(self) -> Floats:
        """The worth of a failed run."""
        return np.full((self.scenarios, 1), self.scale.failed)

    def of(self, cell: CellScore) -> tuple[float, ...]:
        """Returns the values of an answered cell."""
        return (float("nan") if cell.rating is None else float(cell.rating),)

    def is_failure(self, cell: CellScore) -> bool:
        """Returns whether an answer has the worth of a failed run, or no result."""
        return cell.score in {None, self.scale.failed}

    def judge(self, values: Floats) -> tuple[Floats, Floats]:
        """Returns the weighted scores, higher is better, shape (n, 1), and no violations."""
        scores = values[:, :, 0]
        if self.scale.step is not None:
            scores = np.floor(scores / self.scale.step + 0.5) * self.scale.step
        scores = self.scale.sign * np.maximum(self.scale.sign * scores, self.scale.sign * self.scale.failed)
        used = {column: weight for column, weight in enumerate(self.weights.values()) if weight}
        total = weighted(scores[:, list(used)], used.values())
        return self.scale.sign * total[:, np.newaxis], np.where(np.isnan(total), np.nan, 0.0)


@dataclass(frozen=True)
class JudgedGoals:
    """Objectives and constraints on results. The values of a cell follow `keys`."""

    goals: Goals
    names: tuple[str, ...]
    """Names of the scenarios."""
    whole: Goals | None = None
    """Goals that the values of a cell are of, if they are more."""

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """Identities of the values of a cell."""
        whole = self.whole or self.goals
        return tuple(dict.fromkeys(goal.value.key for goal in (*whole.objectives, *whole.bounds)))

    @property
    def _all(self) -> tuple[Objective | Bound, ...]:
        return (*self.goals.objectives, *self.goals.bounds)

    @property
    def scenarios(self) -> int:
        """Number of scenarios."""
        return len(self.names)

    @property
    def values(self) -> int:
        """Number of values of a cell."""
        return len(self.keys)

    @property
    def objectives(self) -> int:
        """Number of objectives."""
        return len(self.goals.objectives)

    @cached_property
    def best(self) -> Floats:
        """The better end of a score's usual range; a measure has no limit. NaN if goals disagree on what is better, as two limits do."""
        ends: dict[str, set[float]] = defaultdict(set)
        for goal in self._all:
            scale = goal.value.scale
            ends[goal.value.key].add(goal.sign * np.inf if scale is None else _better_end(scale, goal.sign))
        return np.tile([each.pop() if len(each) == 1 else np.nan for each in ends.values()], (self.scenarios, 1))

    @cached_property
    def worst(self) -> Floats:
        """The worth of a failed run; NaN for a measure that has none."""
        worth: dict[str, float] = {}
        for goal in self._all:
            scale, failed = goal.value.scale, goal.value.failed
            worth[goal.value.key] = scale.failed if scale is not None else np.nan if failed is None else failed
        return np.tile(list(worth.values()), (self.scenarios, 1))

    def given(self, entries: Columns) -> Floats:
        """Returns the values of n sets that are known without a run, shape (n, n_values); NaN for the others."""
        changes = self.goals.changes
        count = len(next(iter(entries.values())))
        return np.stack([changes[key](entries) if key in changes else np.full(count, np.nan) for key in self.keys], axis=1)

    def of(self, cell: CellScore) -> tuple[float, ...]:
        """Returns the values of an answered cell."""
        known = dict(cell.values) if cell.score is None else {SCORE: cell.score, **cell.values}
        return tuple(float(known.get(key, float("nan"))) for key in self.keys)

    def is_failure(self, cell: CellScore) -> bool:
        """Returns whether an answer is a failed run, or no result. A sound run has its measures, whatever its score is worth."""
        return cell.score is None or cell.failed

    def judge(self, values: Floats) -> tuple[Floats, Floats]:
        """Returns the objectives, higher is better, shape (n, m), and the sums of violations, shape (n,)."""
        places = {name: place for place, name in enumerate(self.names)}
        columns = {key: column for column, key in enumerate(self.keys)}

        def values_of(goal: Goal) -> Floats:
            return values[:, [places[name] for name in goal.shares], columns[goal.value.key]]

        objectives = np.stack([goal.sign * goal.amounts(values_of) for goal in self.goals.objectives], axis=1)
        violations = np.zeros(len(values))
        for bound in self.goals.bounds:
            violations += bound.violations(bound.amounts(values_of))
        return objectives, violations

"""Aims of searches by the cell: the weighted score of a campaign, or its objectives and constraints on results. Pure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from drivecal.analysis.goals import SCORE, Aggregate, Bound, Goal, Goals, Objective, weighted
from drivecal.domain.constraints import Columns
from drivecal.domain.evaluations import CellScore
from drivecal.domain.rounding import grains
from drivecal.domain.scales import Scale
from drivecal.plugins.ports import Floats


def _better_end(scale: Scale) -> float:
    return scale.upper if scale.sign > 0 else scale.lower


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
        return np.full((self.scenarios, 1), _better_end(self.scale))

    @cached_property
    def worst(self) -> Floats:
        """The worth of a failed run."""
        return np.full((self.scenarios, 1), self.scale.failed)

    def of(self, cell: CellScore) -> tuple[float, ...]:
        """Returns the values of an answered cell."""
        return (float("nan") if cell.rating is None else float(cell.rating),)

    def judge(self, values: Floats) -> tuple[Floats, Floats]:
        """Returns the weighted scores, higher is better, shape (n, 1), and no violations."""
        scores = values[:, :, 0]
        if self.scale.step is not None:
            scores = np.floor(scores / self.scale.step + 0.5) * self.scale.step
        scores = self.scale.sign * np.maximum(self.scale.sign * scores, self.scale.sign * self.scale.failed)
        used = {column: weight for column, weight in enumerate(self.weights.values()) if weight}
        total = weighted(np.zeros(len(values)), scores[:, list(used)].T, used.values())
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
        """The better end of a score's usual range; a measure has no limit."""
        ends: dict[str, float] = {}
        for goal in self._all:
            scale = goal.value.scale
            ends.setdefault(goal.value.key, goal.sign * np.inf if scale is None else _better_end(scale))
        return np.tile(list(ends.values()), (self.scenarios, 1))

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

    def judge(self, values: Floats) -> tuple[Floats, Floats]:
        """Returns the objectives, higher is better, shape (n, m), and the sums of violations, shape (n,)."""
        places = {name: place for place, name in enumerate(self.names)}
        columns = {key: column for column, key in enumerate(self.keys)}

        def amounts(goal: Goal) -> Floats:
            if isinstance(goal, Objective) and goal.variants:
                parts = np.stack([amounts(part) for part in goal.parts])
                combined: Floats = goal.sign * (goal.sign * parts).min(axis=0) if goal.worst else parts.mean(axis=0)
                return combined
            here = values[:, [places[name] for name in goal.shares], columns[goal.value.key]]
            return _aggregated(goal.aggregate, here, list(goal.shares.values()))

        objectives = np.stack([goal.sign * amounts(goal) for goal in self.goals.objectives], axis=1)
        violations = np.zeros(len(values))
        for bound in self.goals.bounds:
            missing = bound.sign * (bound.limit - (reached := amounts(bound)))
            broken = np.where(missing <= grains(reached, bound.limit), 0.0, missing / bound.span)
            violations += np.where(np.isnan(missing), np.nan, broken)
        return objectives, violations


def _aggregated(aggregate: Aggregate, values: Floats, shares: Sequence[float]) -> Floats:
    """Returns `aggregate` of each row of values, shape (n, n_scenarios); NaN if a value is missing."""
    match aggregate.kind:
        case "mean":
            return weighted(np.zeros(len(values)), values.T, shares)
        case "min":
            lowest: Floats = values.min(axis=1)
            return lowest
        case "max":
            highest: Floats = values.max(axis=1)
            return highest
        case "quantile":
            order = np.argsort(values, axis=1, kind="stable")
            reached = np.cumsum(np.array(shares)[order], axis=1) >= aggregate.level - 1e-12
            reached[:, -1] = True
            chosen = np.take_along_axis(
                values, np.take_along_axis(order, reached.argmax(axis=1)[:, np.newaxis], axis=1), axis=1
            )
            return np.where(np.isnan(values).any(axis=1), np.nan, chosen[:, 0])

"""Objectives and constraints of a campaign: what they make of the values of one set in its scenarios. Pure.

A value of a cell is the campaign's score, another score (a formula over measures) or a measure. Goals are stored with a campaign as plain
data, so that its results can be read without its problem.
"""

from bisect import bisect_left
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil, isclose, isnan, log, log1p
from statistics import fmean
from typing import Any, Literal

import numpy as np
from pydantic import TypeAdapter

from drivecal.analysis.front import Mask, non_dominated
from drivecal.analysis.replicates import exceeding, rate_bounds
from drivecal.analysis.scoring import LARGEST, rate
from drivecal.bundles.expressions import Formula
from drivecal.domain.constraints import ChangeFrom, ChangeLimit
from drivecal.domain.evaluations import CellScore
from drivecal.domain.parameters import ParameterSet
from drivecal.domain.rounding import grains, levels
from drivecal.domain.scales import Scale
from drivecal.domain.setups import canonical_json, digest
from drivecal.plugins.ports import Floats

SCORE = "score"
"""Key of the campaign's own score, which cells store."""
FAILED = ""
"""In the place of a measure's name: 1 for a failed run, else 0."""
UNDECIDED = 1e-3
"""Largest violation of a rate that may be kept or not, as far as is known; less than that of a rate that is surely exceeded."""
AT_A_TIME = 256
"""Sets that are compared with a front at a time."""
AggregateKind = Literal["mean", "min", "max", "quantile"]
Cells = Mapping[str, CellScore]
"""Answers of a set by scenario."""


@dataclass(frozen=True)
class CellValue:
    """A value of cells; without `formula` and `measure` it is the campaign's score. `failed`: worth of a measure of failed runs, which have
    none without it."""

    scale: Scale | None = None
    """The scale of a score; None for a measure."""
    formula: str | None = None
    measure: str | None = None
    failed: float | None = None
    change: ChangeFrom | None = None
    """A change from a reference set, which is known without a run, in place of a score or a measure."""

    @property
    def key(self) -> str:
        """Identity among the values of a cell."""
        if self.change is not None:
            return f"{self.change.kind} {digest(canonical_json(dict(self.change.reference)).encode())}"
        if self.measure is not None:
            return f"measure {self.measure} {self.failed}"
        return SCORE if self.formula is None or self.scale is None else f"score {self.scale.name}"

    def of(
        self, measures: Mapping[str, float | None], failure: str | None, parameters: ParameterSet | None = None
    ) -> float | None:
        """Returns the value of a set's run; None if it lacks a measure. Measures beyond LARGEST count as LARGEST: sums could overflow."""
        if self.change is not None:
            return None if parameters is None else self.change.of(parameters)
        if self.measure == FAILED:
            return 0.0 if failure is None else 1.0
        if self.measure is not None:
            measured = measures.get(self.measure) if failure is None else self.failed
            return None if measured is None else min(max(measured, -LARGEST), LARGEST)
        if self._formula is None or self.scale is None:
            raise ValueError("the campaign's own score is stored, and not computed again")
        known = {name: value for name, value in measures.items() if value is not None}
        scored = rate(self._formula, self.scale, known, failure)
        return None if scored is None else scored.score

    @cached_property
    def _formula(self) -> Formula | None:
        return None if self.formula is None else Formula(self.formula)


@dataclass(frozen=True, slots=True)
class Aggregate:
    """Combines values of several scenarios into one. A quantile is the least value that, with all lower ones, has the weight `level`."""

    kind: AggregateKind = "mean"
    level: float = 0.5

    def __call__(self, values: Floats, shares: Sequence[float]) -> Floats:
        """Aggregates the values of n sets, shape (n, n_scenarios), with positive shares of sum 1; NaN if a value is missing."""
        match self.kind:
            case "mean":
                return weighted(values, shares)
            case "min":
                return np.asarray(values.min(axis=1))
            case "max":
                return np.asarray(values.max(axis=1))
            case "quantile":
                order = np.argsort(values, axis=1, kind="stable")
                reached = np.cumsum(np.array(shares)[order], axis=1) >= self.level - 1e-12
                reached[:, -1] = True
                places = np.take_along_axis(order, reached.argmax(axis=1, keepdims=True), axis=1)
                return np.where(np.isnan(values).any(axis=1), np.nan, np.take_along_axis(values, places, axis=1)[:, 0])


@dataclass(frozen=True)
class Goal:
    """A value aggregated over scenarios. `shares`: positive weights by scenario, of sum 1, in the catalogue's order."""

    name: str
    value: CellValue
    shares: Mapping[str, float]
    aggregate: Aggregate

    def values_in(self, cells: Iterable[CellScore | None]) -> Floats:
        """Returns its value in each cell, NaN where it is missing. A cell ranked by another score has the campaign's among its values."""
        key = self.value.key
        known = [None if cell is None else cell.values.get(key, cell.score if key == SCORE else None) for cell in cells]
        return np.array(known, dtype=np.float64)

    def amounts(self, values: "Values") -> Floats:
        """Returns the aggregate for each of n sets; NaN if a value is missing."""
        return self.aggregate(values(self), list(self.shares.values()))


Values = Callable[[Goal], Floats]
"""The values of a goal in its scenarios, shape (n, n_scenarios); NaN where one is missing."""


@dataclass(frozen=True)
class Objective(Goal):
    """An objective. `sign`: 1 if more is better, else -1; `tolerance`: differences that do not count."""

    sign: int
    tolerance: float = 0.0
    unit: str = "1"
    variants: tuple[Mapping[str, float], ...] = ()
    """Shares of each variant, if it combines the objectives of several: their mean, or the `worst`."""
    worst: bool = False

    @cached_property
    def parts(self) -> list["Objective"]:
        """The objectives of its variants."""
        return [replace(self, shares=shares, variants=()) for shares in self.variants]

    def amounts(self, values: Values) -> Floats:
        """See `Goal`."""
        if not self.variants:
            return super().amounts(values)
        amounts = np.stack([part.amounts(values) for part in self.parts])
        worst: Floats = self.sign * (self.sign * amounts).min(axis=0)
        return worst if self.worst else sum(amounts, np.zeros_like(worst)) / len(amounts)

    def is_weighted_mean(self, shares: Mapping[str, float]) -> bool:
        """Returns whether it is the mean of the campaign's score with these weights (Eq. 6)."""
        alike = self.shares.keys() == shares.keys() and all(isclose(self.shares[name], share) for name, share in shares.items())
        return self.value.key == SCORE and self.aggregate.kind == "mean" and alike and not self.variants

    @property
    def span(self) -> float:
        """Width of the declared range; 0 for a measure."""
        return 0.0 if self.value.scale is None else self.value.scale.span


@dataclass(frozen=True)
class Bound(Goal):
    """A constraint: an amount of at least, for `sign` 1, or at most `limit`. `span`: the unit of its violations.

    With a `rate` it bounds the share of a set's runs, over seeds and scenarios, that are beyond the limit: the set keeps it if the exact
    upper bound of the share at this confidence is at most `rate`. Models of searches by the cell look at the limit alone.
    """

    sign: int
    limit: float
    span: float
    rate: float | None = None
    confidence: float = 0.95
    unit: str = "1"

    @property
    def fewest_runs(self) -> int:
        """Number of runs that show the rate if none is beyond the limit; 0 without a rate."""
        return 0 if self.rate is None else ceil(log(1 - self.confidence) / log1p(-self.rate) - 1e-9)

    def beyond(self, runs: Iterable[Cells]) -> tuple[int, int]:
        """Returns how many runs are beyond the limit or have no value, and how many runs there are; `runs`: cells by scenario, by seed."""
        values = self.values_in(run[scenario] for run in runs for scenario in self.shares if scenario in run)
        return int(np.count_nonzero(self.violations(values))), len(values)

    def seeds_to_show(self, cells: Iterable[Cells], most: int) -> int:
        """Returns the further seeds that show its rate if no run under them is beyond the limit, `most` + 1 if more."""
        (beyond, runs), rate = self.beyond(cells), self.rate or 0.0
        return bisect_left(
            range(most + 1), True, key=lambda n: rate_bounds(beyond, runs + n * len(self.shares), self.confidence)[1] <= rate
        )

    def excess(self, beyond: int, runs: int, least: float, most: float) -> float:
        """Returns the violation of the rate if the share of the runs `beyond` has these bounds: 0 if it is surely kept. If runs do not
        tell, it is UNDECIDED at most, and the less the more probably the rate is kept."""
        rate = self.rate or 0.0
        if most <= rate:
            return 0.0
        return UNDECIDED * exceeding(beyond, runs, rate) if least <= rate else max(10 * UNDECIDED, beyond / runs - rate)

    def violations(self, amounts: Floats) -> Floats:
        """Returns by how much amounts break it, in spans, of their shape; 0 if it is kept, NaN without an amount. An amount that equals
        the limit but for rounding keeps it."""
        missing = self.sign * (self.limit - amounts)
        return np.where(missing <= grains(amounts, self.limit), 0.0, np.minimum(missing, LARGEST * self.span) / self.span)


@dataclass(frozen=True, slots=True)
class Judged:
    """A set's objectives and constrained amounts, in their order and units, and its sum of violations."""

    amounts: tuple[float, ...]
    violation: float
    bounded: tuple[float, ...] = ()
    undecided: bool = False
    """Further runs may show that all constraints are kept: rates alone are in the way, and none is surely exceeded."""

    @property
    def broken(self) -> bool:
        """True if the set breaks a constraint."""
        return self.violation > 0


@dataclass(frozen=True)
class Goals:
    """All objectives and constraints of a campaign."""

    objectives: tuple[Objective, ...]
    bounds: tuple[Bound, ...] = ()
    is_weighted_score: bool = False
    """They are the default: the mean of the campaign's score with its weights (Eq. 6), which has ratings and references."""

    @cached_property
    def computed(self) -> dict[str, CellValue]:
        """Values that cells do not store, by key."""
        values = [goal.value for goal in (*self.objectives, *self.bounds)]
        return {value.key: value for value in values if value.key != SCORE}

    @cached_property
    def bound_names(self) -> list[str]:
        """Names of the constrained amounts, made unique: the second and later uses of a name get a number. A rate has three: the share of
        runs that was found, and its bounds."""
        names: list[str] = []
        for bound in self.bounds:
            name = _numbered(bound.name, names)
            wanted = [name] if bound.rate is None else [name, f"{name}_lower", f"{name}_upper"]
            names += [_numbered(each, names) for each in wanted]
        return names

    def named_bounds(self, judgement: Judged) -> dict[str, float]:
        """Returns the constrained amounts of a set by the names of the constraints."""
        return dict(zip(self.bound_names, judgement.bounded, strict=True))

    @cached_property
    def _by_scenario(self) -> dict[str, tuple[str, str]]:
        """Scenario and key of each value that makes an objective or a constrained amount, but for the campaign's score."""
        labels: dict[tuple[str, str], str] = {}
        places: dict[str, tuple[str, str]] = {}
        for goal in (*self.objectives, *self.bounds):
            named = (goal.name, goal.value.key)
            if goal.value.key != SCORE and goal.value.change is None and named not in labels:
                labels[named] = _numbered(goal.name, labels.values())
            places |= {f"{labels[named]}@{scenario}": (scenario, goal.value.key) for scenario in goal.shares if named in labels}
        return places

    @property
    def value_names(self) -> list[str]:
        """Names of `named_values`."""
        return list(self._by_scenario)

    def named_values(self, cells: Cells) -> dict[str, float]:
        """Returns what makes the objectives and constrained amounts of a set, by `NAME@SCENARIO`; the campaign's score is left out."""
        return {
            name: cells[scenario].values[key]
            for name, (scenario, key) in self._by_scenario.items()
            if scenario in cells and key in cells[scenario].values
        }

    @property
    def is_vector(self) -> bool:
        """True if an optimizer needs the ability `objectives`."""
        return len(self.objectives) > 1 or bool(self.bounds)

    @property
    def changes(self) -> dict[str, ChangeFrom]:
        """The changes from a reference among the values, by key."""
        return {key: value.change for key, value in self.computed.items() if value.change is not None}

    @property
    def limits(self) -> tuple[ChangeLimit, ...]:
        """Limits of changes, which no run is needed for."""
        return tuple(ChangeLimit(each.value.change, each.limit) for each in self.bounds if each.value.change is not None)

    @property
    def valued(self) -> Callable[[Mapping[str, float | None], str | None, ParameterSet], dict[str, float]] | None:
        """Computes the values of a run that cells do not store; None if there are none."""
        return self.values if self.computed else None

    def values(
        self, measures: Mapping[str, float | None], failure: str | None, parameters: ParameterSet | None = None
    ) -> dict[str, float]:
        """Returns the computed values of a set's run, by key, without values that the run lacks."""
        values = {key: value.of(measures, failure, parameters) for key, value in self.computed.items()}
        return {key: value for key, value in values.items() if value is not None}

    @property
    def fewest_seeds(self) -> int:
        """Number of seeds that show all rates if no run is beyond a limit."""
        return max((ceil(bound.fewest_runs / len(bound.shares)) for bound in self.bounds), default=0)

    def judge(self, sets: Sequence[Cells], runs: Sequence[Sequence[Cells]] = ()) -> Iterator[Judged | None]:
        """Yields the judgement of each set from its cells by scenario; None if a value is missing. `runs`: the cells of each set by seed,
        which rates count, if `sets` has means."""

        def values(goal: Goal) -> Floats:
            return goal.values_in(cells.get(scenario) for cells in sets for scenario in goal.shares).reshape(
                len(sets), len(goal.shares)
            )

        amounts = [goal.amounts(values) for goal in (*self.objectives, *self.bounds)]
        first, last = len(self.objectives), len(amounts)
        amounts += [bound.violations(each) for bound, each in zip(self.bounds, amounts[first:], strict=True)]
        for place, row in enumerate(zip(*np.stack(amounts).tolist(), strict=True)):
            if any(map(isnan, row)):
                yield None
                continue
            bounded, violations, undecided = list[float](), list[float](), 0
            for bound, amount, violation in zip(self.bounds, row[first:last], row[last:], strict=True):
                if bound.rate is None:
                    bounded.append(amount)
                    violations.append(violation)
                    continue
                beyond, count = bound.beyond(runs[place] if runs else [sets[place]])
                ends = rate_bounds(beyond, count, bound.confidence)
                bounded += beyond / count, *ends
                violations.append(bound.excess(beyond, count, *ends))
                undecided += 0 < violations[-1] <= UNDECIDED
            is_open = undecided > 0 and undecided == sum(violation > 0 for violation in violations)
            yield Judged(row[:first], sum(violations, 0.0), tuple(bounded), is_open)

    def compared(self, judgement: Judged) -> tuple[float, ...]:
        """Returns the objectives of a set, higher is better."""
        return tuple(goal.sign * amount for goal, amount in zip(self.objectives, judgement.amounts, strict=True))

    def signed(self, judgements: Iterable[Judged]) -> Floats:
        """Returns objectives, higher is better, shape (n, m)."""
        return np.array(list(map(self.compared, judgements)), dtype=np.float64).reshape(-1, len(self.objectives))

    def slacks(self, points: Floats, others: Floats) -> Floats:
        """Returns the largest differences of signed objectives that do not count, of the shape of both."""
        tolerances = np.array([goal.tolerance for goal in self.objectives], dtype=np.float64)
        return np.maximum(tolerances, grains(points, others, np.array([goal.span for goal in self.objectives])))

    def alike(self, points: Floats) -> Sequence[Sequence[int]]:
        """Groups points, signed objectives of sets, whose differences from the group's first point do not count."""
        groups: list[list[int]] = []
        firsts = np.empty_like(points)
        for place, point in enumerate(points):
            known = firsts[: len(groups)]
            equal = np.flatnonzero((np.abs(known - point) <= self.slacks(known, point)).all(axis=1))
            if equal.size:
                groups[int(equal[0])].append(place)
            else:
                firsts[len(groups)] = point
                groups.append([place])
        return groups

    def leading(self, points: Floats, violations: Floats) -> Mask:
        """Returns which sets no other set dominates, shape (n,), by signed objectives, shape (n, m), and sums of violations, shape (n,).

        A set dominates another one if it is better in an objective and worse in none; differences up to the tolerance do not count. Such
        sets may dominate each other in a circle: if that leaves none, tolerances do not count either.
        """
        rounded = [levels(column, goal.span) for column, goal in zip(points.T, self.objectives, strict=True)]
        exact = non_dominated(np.column_stack(rounded).astype(np.float64), violations)
        if not any(goal.tolerance for goal in self.objectives):
            return exact
        candidates = np.flatnonzero(levels(violations) == 0)
        front, kept = points[exact], np.zeros(len(points), dtype=np.bool_)
        for start in range(0, len(candidates), AT_A_TIME):
            some = candidates[start : start + AT_A_TIME]
            gains = front[np.newaxis] - points[some, np.newaxis]
            slacks = self.slacks(front[np.newaxis], points[some, np.newaxis])
            dominated = np.all(gains >= -slacks, axis=2) & np.any(gains > slacks, axis=2)
            kept[some] = ~np.any(dominated, axis=1)
        return kept if True in kept else exact

    def to_json(self) -> dict[str, Any]:
        """Returns plain data."""
        document: dict[str, Any] = _GOALS.dump_python(self, mode="json")
        return document

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> "Goals":
        """Inverts `to_json`."""
        return _GOALS.validate_python(document)


_GOALS = TypeAdapter(Goals)


def normalised(weights: Mapping[str, float]) -> dict[str, float]:
    """Returns the positive weights with a sum of 1."""
    total = sum(weights.values())
    return {name: share for name, weight in weights.items() if weight > 0 and (share := weight / total) > 0}


def weighted_mean(scale: Scale, shares: Mapping[str, float]) -> Goals:
    """Returns the weighted mean of the campaign's score as the only objective (Eq. 6)."""
    objective = Objective(scale.name, CellValue(scale), shares, Aggregate(), scale.sign, 0.0, scale.unit)
    return Goals((objective,), is_weighted_score=True)


def weighted(values: Floats, shares: Iterable[float]) -> Floats:
    """Returns the weighted sum (Eq. 6) of each row of values, added in the order of the columns: other orders have other last bits."""
    return sum((values * np.array(list(shares))).T, np.zeros(len(values)))


def over_seeds(cells: Sequence[CellScore], *, partial: bool = False) -> CellScore:
    """Returns the mean of the answers of a cell under several seeds; seeds without a result do not count. A value that is missing under one
    of them has no mean, `partial`: the mean of the others."""
    known = [cell for cell in cells if cell.score is not None and cell.rating is not None]
    if len(known) < 2:
        return known[0] if known else cells[0]
    keys = dict.fromkeys(key for cell in known for key in cell.values if partial or all(key in each.values for each in known))
    return replace(
        known[0],
        score=fmean([cell.score for cell in known if cell.score is not None]),
        rating=fmean([cell.rating for cell in known if cell.rating is not None]),
        own=all(cell.own for cell in known),
        failed=all(cell.failed for cell in known),
        values={key: fmean([cell.values[key] for cell in known if key in cell.values]) for key in keys},
    )


def _numbered(name: str, taken: Collection[str]) -> str:
    """Returns a name that is not taken: the given one, else with a number behind it."""
    number, free = 2, name
    while free in taken:
        free, number = f"{name} {number}", number + 1
    return free

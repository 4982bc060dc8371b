"""The sensitivity analysis of a campaign as ask/tell. Its phases are the intervals, a confirmation of the cut regions, and the global
analysis in the rest. A parameter that only the global analysis finds without influence gets a confirmation over its whole range.

Nothing is saved. An analysis that is recreated from the same arguments, and receives the scores of all finished phases again, continues
exactly as this one would.

Intervals may be run sequentially, from both ends inwards to the first influential interval on each side. The cut regions follow from these
intervals alone (`scenario.cut`), so the rest needs no run. An interval takes no more samples once missing effects cannot change that it is
influential (`thresholds.is_surely_influential`). Points, effects and bounds equal the whole design's. An interval that may still turn out
without influence takes all its samples, because one missing effect over the whole scale outweighs any tolerance.

The rounds of all parameters and both sides run together, so that each has enough runs for many workers.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import numpy.typing as npt

from drivecal.contracts.specification import SensitivitySpecification
from drivecal.domain.constraints import Constraints
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.parameters import Indices, ParameterSpace
from drivecal.domain.regions import FeasibleRegion
from drivecal.domain.scales import COMFORT, Scale
from drivecal.sensitivity.designs import (
    COLUMNS,
    Design,
    Floats,
    SobolRows,
    lines_design,
    paper_design,
    radial_design,
    regions_design,
)
from drivecal.sensitivity.scenario import (
    ScenarioInfluence,
    ScenarioState,
    check_intervals,
    interval_edges,
    intervals_of,
    most_confirmations,
    tells_nothing,
)
from drivecal.sensitivity.thresholds import Threshold, is_surely_influential, measures, verdict

PARTS = 2
"""Equal parts of an interval's samples, each followed by a check. More parts save little more and make rounds smaller (decision 026)."""


class IntervalRuns:
    """The runs of a design's intervals in a scenario, round by round: `rows` of the design's points, then their scores to `tell`.

    All rows are one round unless they are chosen one after the other (`sequential`).
    """

    def __init__(self, design: Design, threshold: Threshold, *, sequential: bool, scale: Scale = COMFORT) -> None:
        """`design`: effects of shape (n_p, n_Int, r), each with a second run of its own if they are chosen sequentially."""
        self.design = design
        self._threshold, self._scale = threshold, scale
        self._sequential = sequential
        self._made = np.zeros(len(design.points), dtype=bool)
        self._verdicts: list[list[bool | None]] = [
            [False if gap else None for gap in row] for row in np.isnan(design.judged[..., 0])
        ]
        self._samples = np.zeros(design.judged.shape[:2], dtype=np.int64)
        self._rows: Indices | None = None
        self.scores: Floats = np.full(len(design.points), np.nan)
        """Scores of all points; NaN if a run failed or was not made."""

    @property
    def effects(self) -> Floats:
        """Elementary effects, shape (n_p, n_Int, r); NaN if a run failed or was not made."""
        return self.design.effects(self.scores, self._scale.span)

    def rows(self) -> Indices:
        """Returns the next rows to run, increasing, the same until their scores arrive; empty if no more are needed."""
        if self._rows is None:
            self._rows = self._chosen() if self._sequential else np.flatnonzero(~self._made)
        return self._rows

    def tell(self, scores: Floats) -> None:
        """Takes the scores of `rows`, shape (n_rows,)."""
        rows, self._rows = self.rows(), None
        self.scores[rows], self._made[rows] = scores, True
        if self._sequential:
            self._judge()

    def _chosen(self) -> Indices:
        """Returns the runs of the next samples on both fronts of every parameter that were not made yet."""
        samples = self.design.judged.shape[2]
        size = -(-samples // PARTS)
        wanted = np.zeros_like(self._made)
        for place in self._fronts():
            start = self._samples[place]
            for ends in (self.design.first, self.design.second):
                wanted[ends[place][start : start + size]] = True
            self._samples[place] = min(start + size, samples)
        return np.flatnonzero(wanted & ~self._made)

    def _judge(self) -> None:
        effects = self.effects
        for place in self._fronts():
            column, interval = place
            known, steps, count = effects[place], self.design.judged[place], int(self._samples[place])
            if count == known.size:
                statistics = measures(known)
                self._verdicts[column][interval] = verdict(
                    statistics, steps[~np.isnan(known)], self._threshold, self._scale
                ).influential
            elif is_surely_influential(known[:count], steps[:count], steps[count:], self._threshold, self._scale):
                self._verdicts[column][interval] = True

    def _fronts(self) -> Iterator[tuple[int, int]]:
        """Yields the column and the number of the undecided intervals next to what is decided, from both ends of each parameter.

        As long as no run scored better than a failed one the fronts pass influential intervals as well: a scenario is unknown only after
        all runs.
        """
        is_silent = tells_nothing(self.scores, self._scale)
        for column, verdicts in enumerate(self._verdicts):
            below = _front(verdicts, is_silent=is_silent)
            above = _front(verdicts[::-1], is_silent=is_silent)
            ends = {below, None if above is None else len(verdicts) - 1 - above}
            yield from ((column, interval) for interval in sorted(end for end in ends if end is not None))


def _front(verdicts: Sequence[bool | None], *, is_silent: bool) -> int | None:
    """The first undecided interval; None if there is none before the first influential one."""
    for interval, influential in enumerate(verdicts):
        if influential is None:
            return interval
        if influential and not is_silent:
            return None
    return None


PhaseName = Literal["intervals", "confirmation", "global"]

_INTERVALS, _GLOBAL, _WHOLE_RANGE, _FIRST_CONFIRMATION = 0, 1, 2, 3
"""Sobol' sequences of the phases; each round of confirmation has its own. The round after the global analysis has its own as well, for
the number of the earlier ones depends on the other scenarios."""


@dataclass(frozen=True, slots=True)
class Phase:
    """Runs that can be made in any order. `number` counts from 0; several rounds of intervals or confirmations share a name.

    `points`: grid indices of the searched parameters by scenario, shape (n, n_searched). Scenarios without a run are missing.
    Points may repeat; equal arrays are one object if all scenarios share them. `samples`: the sample of each point by scenario, from 0,
    shape (n,); runs of a random simulator have a seed for each.
    """

    number: int
    name: PhaseName
    points: Mapping[str, Indices]
    samples: Mapping[str, Indices]


class SensitivityAnalysis:
    """An analysis of all scenarios, a deterministic function of its arguments and of the scores."""

    def __init__(
        self,
        space: ParameterSpace,
        scenarios: Sequence[str],
        settings: SensitivitySpecification,
        scale: Scale = COMFORT,
        constraints: Constraints | None = None,
    ) -> None:
        """Raises InvalidInputError if nothing is searched or the intervals are finer than a parameter's grid.

        `constraints`: points that break them are never asked, and count as failed runs: what is said rests on the steps between feasible
        points. With any, all phases and both designs consist of `regions_design`.
        """
        if not space.searched:
            raise InvalidInputError(Problem("fixed", "every parameter is fixed", "leave at least one to be searched"))
        check_intervals(space, settings.intervals)
        self._space = space
        self._settings, self._scale = settings, scale
        self._constraints = constraints or Constraints(space)
        self._unordered = np.array([kind == "choice" for kind in space.kinds], dtype=np.bool_)
        self._edges = [interval_edges(n, count) for n, count in zip(space.n_values.tolist(), self._counts(), strict=True)]
        self._states = {scenario: ScenarioState(space, self._edges, settings.threshold, scale) for scenario in scenarios}
        self._number = 0
        self._confirmed = 0
        self._name: PhaseName | None = "intervals"
        self._intervals: dict[str, IntervalRuns] = {}
        self._designs: dict[str, Design] = {}
        self._points: dict[str, Indices] | None = None
        """All points of the phase."""
        self._asked: dict[str, npt.NDArray[np.bool_]] = {}
        """Points that are run, by scenario."""

    def _counts(self) -> list[int]:
        return [intervals_of(parameter, self._settings.intervals) for parameter in self._space.searched]

    def expected_runs(self) -> dict[PhaseName, int]:
        """Runs per scenario and phase at most; without constraints exact for intervals that are not `sequential` (Eq. 3 for `paper`).

        Confirmation is cheaper by far where few regions are given back, and repeats are answered without a run.
        """
        n_p, r, counts = len(self._space.searched), self._settings.samples, self._counts()
        paper = self._settings.design == "paper"
        first = sum(counts) * r * (n_p + 1) if paper else r * (1 + sum(2 * count - 1 for count in counts))
        first, last = (2 * r * sum(counts), 2 * r * n_p) if self._constraints else (first, r * (n_p + 1))
        return {"intervals": first, "confirmation": 2 * r * sum(map(most_confirmations, counts)), "global": last}

    def ask(self) -> Phase | None:
        """Returns the next phase, the same until its scores arrive; None when the analysis is finished."""
        while self._name is not None:
            if self._points is None:
                self._points = self._drawn()
                self._asked = {scenario: self._constraints.feasible(drawn) for scenario, drawn in self._points.items()}
            if any(mask.any() for mask in self._asked.values()):
                points = self._to_run(self._points)
                samples = {scenario: self._samples(scenario)[self._asked[scenario]] for scenario in points}
                return Phase(self._number, self._name, points, samples)
            self._take({scenario: np.full(len(points), np.nan) for scenario, points in self._points.items()})
        return None

    def tell(self, scores: Mapping[str, Floats]) -> None:
        """The finite scores of the points of the phase asked last, by scenario, shape (n,); NaN if a run failed.

        Raises RuntimeError if nothing was asked.
        """
        if self._points is None:
            raise RuntimeError("no phase awaits scores; ask for a phase first")
        complete = {scenario: np.full(len(points), np.nan) for scenario, points in self._points.items()}
        for scenario, known in scores.items():
            complete[scenario][self._asked[scenario]] = known
        self._take(complete)

    def _take(self, scores: Mapping[str, Floats]) -> None:
        """Takes the scores of all points of the phase, NaN for points without a run."""
        for scenario in scores:
            state, answers = self._states[scenario], scores[scenario]
            if self._name == "intervals":
                self._tell_interval_runs(scenario, answers)
                continue
            design = self._designs[scenario]
            effects = design.effects(answers, self._scale.span)
            if self._name == "confirmation":
                state.take_confirmations(effects, design.judged)
            else:
                state.take_overall(answers, effects, design.judged)
        self._confirmed += self._name == "confirmation"
        self._points = None
        self._number += 1
        self._name = self._next()

    def _to_run(self, points: Mapping[str, Indices]) -> dict[str, Indices]:
        """Returns the points that are run; equal arrays stay one object."""
        kept = {id(drawn): drawn if (mask := self._asked[name]).all() else drawn[mask] for name, drawn in points.items()}
        return {scenario: kept[id(drawn)] for scenario, drawn in points.items() if self._asked[scenario].any()}

    def _samples(self, scenario: str) -> Indices:
        """Returns the sample of each point of the phase."""
        if self._name != "intervals":
            return self._designs[scenario].samples
        runs = self._intervals[scenario]
        return runs.design.samples[runs.rows()]

    def result(self) -> dict[str, ScenarioInfluence]:
        """Returns the results by scenario. Raises RuntimeError before the analysis is finished."""
        if self._name is not None:
            raise RuntimeError("the analysis is not finished: ask for its next phase")
        return {scenario: state.result() for scenario, state in self._states.items()}

    def _tell_interval_runs(self, scenario: str, scores: Floats) -> None:
        runs = self._intervals[scenario]
        runs.tell(scores)
        if runs.rows().size == 0:
            self._states[scenario].take_intervals(runs.scores, runs.effects, runs.design.judged)

    def _next(self) -> PhaseName | None:
        if any(runs.rows().size for runs in self._intervals.values()):
            return "intervals"
        if any(state.waiting for state in self._states.values()):
            return "confirmation"
        return "global" if any(state.awaits_overall for state in self._states.values()) else None

    def _drawn(self) -> dict[str, Indices]:
        if self._name == "intervals":
            return self._interval_points()
        self._designs = self._confirming_designs() if self._name == "confirmation" else self._global_designs()
        return {scenario: design.points for scenario, design in self._designs.items()}

    def _interval_points(self) -> dict[str, Indices]:
        if not self._intervals:
            make, settings = paper_design if self._settings.design == "paper" else lines_design, self._settings
            if self._constraints:
                most = max(self._counts())
                listed = [[*pairwise(marks.tolist()), *[(0, 0)] * most][:most] for marks in self._edges]
                boxes = [(column, *box) for column, each in enumerate(listed) for box in each]
                shared = self._pairs(boxes, _INTERVALS, (len(listed), most))
            else:
                shared = make(self._space.n_values, self._edges, settings.samples, settings.seed, _INTERVALS, self._unordered)
            sequential = self._settings.sequential and self._settings.design == "lines"
            self._intervals = {
                scenario: IntervalRuns(shared, self._settings.threshold, sequential=sequential, scale=self._scale)
                for scenario in self._states
            }
        drawn: dict[bytes, Indices] = {}
        points = {}
        for scenario, runs in self._intervals.items():
            if (rows := runs.rows()).size:
                points[scenario] = drawn.setdefault(rows.tobytes(), runs.design.points[rows])
                points[scenario].flags.writeable = False
        return points

    def _confirming_designs(self) -> dict[str, Design]:
        is_last = not any(state.awaits_overall for state in self._states.values())
        tag = _WHOLE_RANGE if is_last else _FIRST_CONFIRMATION + self._confirmed
        regions = {
            scenario: [(box.column, *state.bounds(box)) for box in state.waiting]
            for scenario, state in self._states.items()
            if state.waiting
        }
        return {scenario: self._pairs(region, tag) for scenario, region in regions.items()}

    def _pairs(self, regions: Sequence[tuple[int, int, int]], tag: int, shape: tuple[int, ...] = ()) -> Design:
        given, whole = self._settings, self._constraints.whole_region if self._constraints else None
        inside = whole if isinstance(whole, FeasibleRegion) else None
        return regions_design(self._space.n_values, regions, given.samples, given.seed, tag, self._unordered, inside, shape)

    def _global_designs(self) -> dict[str, Design]:
        n_values = self._space.n_values
        rows = SobolRows(COLUMNS * len(n_values), self._settings.seed, _GLOBAL, 1)
        boxes = {scenario: state.box() for scenario, state in self._states.items() if not state.unknown}
        if self._constraints:
            columns = np.arange(len(n_values))
            return {name: self._pairs(np.stack([columns, *box], axis=1).tolist(), _GLOBAL) for name, box in boxes.items()}
        return {
            scenario: radial_design(n_values, rows, *box, self._settings.samples, unordered=self._unordered)
            for scenario, box in boxes.items()
        }

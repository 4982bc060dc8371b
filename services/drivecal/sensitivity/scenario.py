"""State and result of the analysis of a scenario: what is cut, what confirms it, and the analysis that decided, in words.

Non-influential intervals are cut from both ends inwards until the first influential one. Intervals share their edges, so that every
step between neighbouring values lies in exactly one of them: a change between the last value of one interval and the first of the next
cannot be missed. What is cut are the values strictly outside the kept intervals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from drivecal.contracts.tables import DecidedBy
from drivecal.domain.errors import Diagnostics
from drivecal.domain.influence import EVERYWHERE, Influence
from drivecal.domain.parameters import Indices, Parameter, ParameterSpace
from drivecal.domain.scales import COMFORT, Scale
from drivecal.sensitivity.designs import Floats
from drivecal.sensitivity.thresholds import EffectStatistics, Threshold, Verdict, measures, smallest_nonzero, verdict


def interval_edges(n_values: int, intervals: int) -> Indices:
    """The grid indices where equal intervals meet, shape (intervals + 1,), from 0 to n_values - 1; strictly increasing if they fit."""
    return (2 * np.arange(intervals + 1) * (n_values - 1) + intervals) // (2 * intervals)


def intervals_of(parameter: Parameter, intervals: int) -> int:
    """Returns the number of intervals of a parameter: of an integer at most its steps; of a choice one, for it is cut as a whole or not at
    all: its values have no order.
    """
    if parameter.kind == "choice":
        return 1
    return min(intervals, parameter.n_values - 1) if parameter.kind == "integer" else intervals


def check_intervals(space: ParameterSpace, intervals: int) -> None:
    """Raises InvalidInputError naming every parameter whose grid has fewer steps than there would be intervals, and what would fit."""
    fitting = min((each.n_values - 1 for each in space.searched if each.kind in {"grid", "continuous"}), default=1)
    diagnostics = Diagnostics()
    for parameter in space.searched:
        if parameter.n_values - 1 < intervals_of(parameter, intervals):
            grid = f"the grid of {parameter.name}, which has {parameter.n_values} values"
            diagnostics.add("sensitivity.intervals", f"{intervals} intervals are finer than {grid}", f"give at most {fitting}")
    diagnostics.raise_if_any()


@dataclass(frozen=True, slots=True)
class Region:
    """Intervals that may be cut: a number of them at the lower end (`below`) or the upper end (`above`), or all of them (`whole`)."""

    column: int
    side: Literal["below", "above", "whole"]
    intervals: int

    def bounds(self, edges: Indices) -> tuple[int, int]:
        """The first and the last grid index that are cut."""
        if self.side == "below":
            return 0, int(edges[self.intervals]) - 1
        if self.side == "above":
            return int(edges[-1 - self.intervals]) + 1, int(edges[-1])
        return 0, int(edges[-1])

    def given_back(self) -> Region | None:
        """Returns the regions left to confirm if the whole region is influential.

        Its inner half, rounded up, is given back: influence is likelier next to the influential intervals, and halving costs a few
        more analyses only if giving back everything would lose most of what is cut. The rest must be confirmed by an analysis of
        its own. A whole range has no inner half and is given back as a whole: no place in it is known to be the influential one.
        """
        left = 0 if self.side == "whole" else self.intervals // 2
        return Region(self.column, self.side, left) if left else None


def cut(column: int, influential: Sequence[bool]) -> list[Region]:
    """The regions of one parameter that may be cut, from which of its intervals are influential, in order from lower to upper."""
    if not any(influential):
        return [Region(column, "whole", len(influential))]
    below = list(influential).index(True)
    above = list(reversed(influential)).index(True)
    regions = [Region(column, "below", below)] if below else []
    return [*regions, Region(column, "above", above)] if above else regions


def most_confirmations(intervals: int) -> int:
    """Confirming analyses of one parameter at most, over all rounds: each halving of a region takes one, and the whole range another."""
    halvings = [below.bit_length() + (intervals - 1 - below).bit_length() for below in range(intervals)]
    return 1 + max(halvings)


@dataclass(frozen=True, slots=True)
class RegionConfirmation:
    """An analysis over a whole cut region: its first and last grid index, and the result."""

    region: Region
    lower: int
    upper: int
    verdict: Verdict


@dataclass(frozen=True, slots=True)
class ParameterInfluence:
    """Result for a parameter in a scenario.

    `influence` is the result of all analyses. `intervals` go from the lower end to the upper. `confirmations` are the analyses of its cut
    regions, in order. `overall` is the global analysis inside the influential box; None without it (the scenario is unknown).
    """

    influence: Influence
    intervals: tuple[Verdict, ...]
    confirmations: tuple[RegionConfirmation, ...]
    overall: Verdict | None

    @property
    def s_rel_intervals(self) -> tuple[float, ...]:
        """s_rel of each interval; NaN where fewer than two effects are known."""
        return tuple(interval.measures.s_rel for interval in self.intervals)


@dataclass(frozen=True, slots=True)
class ScenarioInfluence:
    """Results by parameter name. If `unknown`, no run scored better than a failed run, so every parameter counts as influential.

    `smallest_interval_s_rel` and `smallest_overall_s_rel` are the smallest values above zero; None if all are zero. With a threshold below
    them, any change counts.
    """

    parameters: Mapping[str, ParameterInfluence]
    unknown: bool
    smallest_interval_s_rel: float | None
    smallest_overall_s_rel: float | None


def tells_nothing(scores: Floats, scale: Scale = COMFORT) -> bool:
    """Returns whether no run scored better than a failed run: then equal scores do not mean that parameters are without influence."""
    return bool(np.all(np.isnan(scores) | (scores == scale.failed)))


class ScenarioState:
    """Takes the effects of each phase and decides the next analyses."""

    def __init__(self, space: ParameterSpace, edges: Sequence[Indices], threshold: Threshold, scale: Scale = COMFORT) -> None:
        """`edges` has the edges of each searched parameter's intervals; their numbers may differ."""
        self._space = space
        self._edges = edges
        self._threshold, self._scale = threshold, scale
        self._intervals: list[tuple[Verdict, ...]] = [() for _ in edges]
        self._confirmations: list[list[RegionConfirmation]] = [[] for _ in edges]
        self._cut: list[dict[str, Region]] = [{} for _ in edges]
        self._overall: list[Verdict] | None = None
        self.unknown = False
        self.waiting: list[Region] = []
        """Regions to be confirmed in the next round."""

    def take_intervals(self, scores: Floats, effects: Floats, steps: Floats) -> None:
        """Cuts regions without influence. `scores` has all runs; `effects` and `steps` have the shape (n_p, n_Int, r).

        An interval without steps counts as influential if any other one is.
        """
        for column in range(len(self._edges)):
            count = len(self._edges[column]) - 1
            rows = zip(effects[column][:count], steps[column][:count], strict=True)
            self._intervals[column] = tuple(self._verdict(*row) for row in rows)
        self.unknown = tells_nothing(scores, self._scale)
        if not self.unknown:
            for column, verdicts in enumerate(self._intervals):
                influential, reached = (
                    np.array([each.influential for each in verdicts]),
                    ~np.isnan(steps[column][: len(verdicts), 0]),
                )
                self._try(cut(column, (influential & (influential & reached).any()).tolist()))

    def take_confirmations(self, effects: Floats, steps: Floats) -> None:
        """Restores influential regions. `effects`, `steps`: shape (n_waiting, r), in the order of `waiting`."""
        regions, self.waiting = self.waiting, []
        for region, *row in zip(regions, effects, steps, strict=True):
            confirmed = self._verdict(*row)
            lower, upper = self.bounds(region)
            self._confirmations[region.column].append(RegionConfirmation(region, lower, upper, confirmed))
            if confirmed.influential:
                del self._cut[region.column][region.side]
                left = region.given_back()
                self._try([left] if left else [])

    def take_overall(self, scores: Floats, effects: Floats, steps: Floats) -> None:
        """The global analysis: `effects`, `steps` of shape (n_p, r). If it has no information, the results of the intervals stand.

        It cuts nothing alone: a parameter with influential intervals awaits an analysis over its whole range, unless one has refuted that.
        """
        verdicts = [self._verdict(*row) for row in zip(effects, steps, strict=True)]
        self._overall = verdicts
        if tells_nothing(scores, self._scale):
            return
        for column, overall in enumerate(verdicts):
            whole, done = "whole" in self._cut[column], self._confirmations[column]
            is_refuted = any(each.region.side == "whole" and each.verdict.influential for each in done)
            if whole and overall.influential:
                self._cut[column] = {}
            elif not (overall.influential or whole or is_refuted):
                self._try([Region(column, "whole", len(self._edges[column]) - 1)])

    @property
    def awaits_overall(self) -> bool:
        """True if the global analysis is still to come."""
        return not self.unknown and self._overall is None

    def bounds(self, region: Region) -> tuple[int, int]:
        """The first and the last grid index of a region."""
        return region.bounds(self._edges[region.column])

    def box(self) -> tuple[Indices, Indices]:
        """The influential box as inclusive grid indices, shape (n_p,) each; the full range if nothing or everything is cut."""
        pairs = [self._kept(column) for column in range(len(self._edges))]
        lower, upper = np.array(pairs, dtype=np.int64).T
        return lower, upper

    def result(self) -> ScenarioInfluence:
        """Returns the results by searched parameter."""
        influences: dict[str, ParameterInfluence] = {}
        for column, parameter in enumerate(self._space.searched):
            overall = None if self._overall is None else self._overall[column]
            confirmations = tuple(self._confirmations[column])
            influences[parameter.name] = ParameterInfluence(
                self._influence(column), self._intervals[column], confirmations, overall
            )
        all_intervals = [interval.measures for row in self._intervals for interval in row]
        all_overall: list[EffectStatistics] = [] if self._overall is None else [overall.measures for overall in self._overall]
        return ScenarioInfluence(influences, self.unknown, smallest_nonzero(all_intervals), smallest_nonzero(all_overall))

    def _influence(self, column: int) -> Influence:
        regions, parameter = self._cut[column], self._space.searched[column]
        if not regions:
            return EVERYWHERE
        if "whole" in regions:
            return Influence(influential=False)
        lower, upper = self._kept(column)
        return Influence(
            influential=True,
            lower=parameter.value(lower) if "below" in regions else None,
            upper=parameter.value(upper) if "above" in regions else None,
        )

    def _kept(self, column: int) -> tuple[int, int]:
        regions, last = self._cut[column], int(self._edges[column][-1])
        lower = self.bounds(regions["below"])[1] + 1 if "below" in regions else 0
        upper = self.bounds(regions["above"])[0] - 1 if "above" in regions else last
        return lower, upper

    def _try(self, regions: Sequence[Region]) -> None:
        """Cuts regions provisionally. A region of a single value needs no confirmation: it holds no step."""
        for region in regions:
            self._cut[region.column][region.side] = region
            lower, upper = self.bounds(region)
            if upper > lower:
                self.waiting.append(region)

    def _verdict(self, effects: Floats, steps: Floats) -> Verdict:
        return verdict(measures(effects), steps[~np.isnan(effects)], self._threshold, self._scale)


def decided_by(result: ParameterInfluence, *, unknown: bool) -> DecidedBy:
    """Returns the analysis that decided about a parameter. `unknown`: no run of the scenario was better than a failed one."""
    if unknown:
        return "unknown"
    seen = any(interval.influential for interval in result.intervals)
    if seen == result.influence.influential:
        return "intervals"
    confirmed = any(done.region.side == "whole" and done.verdict.influential for done in result.confirmations)
    return "confirmation" if confirmed and result.influence.influential else "global"

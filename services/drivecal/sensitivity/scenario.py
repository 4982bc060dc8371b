"""State of the analysis of a scenario, and its result."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from drivecal.domain.influence import EVERYWHERE, Influence
from drivecal.domain.parameters import Indices, ParameterSpace
from drivecal.domain.scales import COMFORT, Scale
from drivecal.sensitivity.cutting import Region, cut
from drivecal.sensitivity.effects import EffectStatistics, Floats, measures, smallest_nonzero
from drivecal.sensitivity.thresholds import Threshold, Verdict, verdict


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

    `influence`: what holds. `intervals`: from the lower end to the upper. `confirmations`: of its cut regions, in order. `overall`: the
    global analysis inside the influential box, None if there was none (the scenario is unknown).
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
    """By parameter name. `unknown`: no run scored better than a failed one, so nothing is known and everything counts as influential.

    `smallest_interval_s_rel`, `smallest_overall_s_rel`: the smallest that are not zero, None if all are. A threshold below them
    means any change at all.
    """

    parameters: Mapping[str, ParameterInfluence]
    unknown: bool
    smallest_interval_s_rel: float | None
    smallest_overall_s_rel: float | None


def tells_nothing(scores: Floats, scale: Scale = COMFORT) -> bool:
    """Whether no run scored better than a failed one: then equal scores do not mean that parameters are without influence."""
    return bool(np.all(np.isnan(scores) | (scores == scale.failed)))


class ScenarioState:
    """Takes in the effects of each phase and says what is to be analysed next."""

    def __init__(self, space: ParameterSpace, edges: Sequence[Indices], threshold: Threshold, scale: Scale = COMFORT) -> None:
        """`edges`: of each searched parameter's intervals; their numbers may differ."""
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
        """Cuts. `scores`: of all runs; `effects`, `steps`: shape (n_p, n_Int, r)."""
        for column in range(len(self._edges)):
            count = len(self._edges[column]) - 1
            rows = zip(effects[column][:count], steps[column][:count], strict=True)
            self._intervals[column] = tuple(self._verdict(*row) for row in rows)
        self.unknown = tells_nothing(scores, self._scale)
        if not self.unknown:
            for column, verdicts in enumerate(self._intervals):
                self._try(cut(column, [interval.influential for interval in verdicts]))

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
            whole = "whole" in self._cut[column]
            if whole and overall.influential:
                self._cut[column] = {}
            elif not overall.influential and not whole and not self._is_refuted(column):
                self._try([Region(column, "whole", len(self._edges[column]) - 1)])

    @property
    def awaits_overall(self) -> bool:
        """Whether the global analysis is still to come."""
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

    def _is_refuted(self, column: int) -> bool:
        """Whether an analysis over the whole range found the parameter influential."""
        return any(done.region.side == "whole" and done.verdict.influential for done in self._confirmations[column])

    def _verdict(self, effects: Floats, steps: Floats) -> Verdict:
        return verdict(measures(effects), steps[~np.isnan(effects)], self._threshold, self._scale)

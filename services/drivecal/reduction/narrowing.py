"""The common reduction (Section III): the search space narrowed to the smallest area outside which no scenario is influenced. Pure.

Neighbouring intervals of an analysis share their edges, so a bound lies in the cut region as well: the sets at the bound answer for those
that are left out. The bounds of a posted map belong to the influential range alone, and so do edges between two values: there the area
holds the next value outside, which answers for the rest.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property

import numpy as np

from drivecal.contracts.campaign import Narrowed
from drivecal.domain.influence import Influence, InfluenceMap
from drivecal.domain.parameters import Indices, Kind, Parameter, ParameterSpace, billionths, decimal, shown


class WholeSpace(StrEnum):
    """The reason why an area is the whole space."""

    ALL_INFLUENTIAL = "no parameter has a region that influences no scenario and holds no start set"
    CONSTRAINED = "a constraint names every parameter with a region that influences no scenario"
    NONE_INFLUENTIAL = "no parameter influences any scenario"
    INFEASIBLE = "no set of the smallest common area keeps all constraints"


@dataclass(frozen=True)
class SearchArea:
    """The box of a space that is searched, as inclusive grid indices of the searched parameters, shape (n_searched,) each.

    An optimizer sees the parameters with more than one value, counted from the box's corner; values keep their places on the space's grid,
    so that stored results are found whatever was narrowed.
    """

    space: ParameterSpace
    first: Indices
    last: Indices
    whole: WholeSpace = WholeSpace.ALL_INFLUENTIAL
    """The reason, if the area is the whole space."""

    @cached_property
    def columns(self) -> Indices:
        """The searched parameters that are left to the optimizer, by position."""
        return np.flatnonzero(self.first < self.last)

    @property
    def n_values(self) -> Indices:
        """Grid sizes for the optimizer, shape (n_left,)."""
        return (self.last - self.first + 1)[self.columns]

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """Kinds of the parameters that are left to the optimizer."""
        return tuple(self.space.kinds[column] for column in self.columns.tolist())

    def expand(self, population: Indices) -> Indices:
        """Grid indices of the space, shape (n, n_searched), of an optimizer's population, shape (n, n_left)."""
        expanded = np.tile(self.first, (len(population), 1))
        expanded[:, self.columns] += population
        return expanded

    def contract(self, indices: Indices) -> Indices:
        """The inverse of `expand`, for sets inside the box."""
        return (indices - self.first)[:, self.columns]

    def narrowed(self) -> list[Narrowed]:
        """The parameters with a smaller range than in the space."""
        narrowed: list[Narrowed] = []
        for parameter, first, last in zip(self.space.searched, self.first.tolist(), self.last.tolist(), strict=True):
            left = last - first + 1
            if left < parameter.n_values:
                narrowed.append(
                    Narrowed(
                        parameter=parameter.name,
                        lower=float(parameter.value(first)),
                        upper=float(parameter.value(last)),
                        full_lower=float(parameter.lower),
                        full_upper=float(parameter.upper),
                        values=parameter.n_values,
                        removed_values=parameter.n_values - left,
                        choice=parameter.choices[first] if parameter.choices and first == last else None,
                    )
                )
        return narrowed

    def note(self) -> str:
        """Returns a note about the removed part."""
        parts: list[str] = []
        for parameter, first, last in zip(self.space.searched, self.first.tolist(), self.last.tolist(), strict=True):
            if first == last:
                parts.append(f"{parameter.name} held at {shown(parameter.named(first))}")
            elif last - first + 1 < parameter.n_values:
                parts.append(f"{parameter.name} from {shown(parameter.named(first))} to {shown(parameter.named(last))}")
        if not parts:
            return f"the search space was not narrowed: {self.whole}"
        share = float(np.prod((self.last - self.first + 1) / self.space.n_values))
        return f"the search space was narrowed to {share:.3g} of its sets: {', '.join(parts)}"


def full_area(space: ParameterSpace, reason: WholeSpace = WholeSpace.ALL_INFLUENTIAL) -> SearchArea:
    """Returns the whole space."""
    return SearchArea(space, np.zeros_like(space.n_values), space.n_values - 1, reason)


def begun_area(area: SearchArea, narrowed: Sequence[Narrowed]) -> SearchArea:
    """Returns the area that a campaign began with, as stored, in the space of `area`: another release may have narrowed otherwise."""
    whole = full_area(area.space)
    first, last = whole.first, whole.last
    by_name = {cut.parameter: cut for cut in narrowed}
    for column, parameter in enumerate(area.space.searched):
        if parameter.name in by_name:
            cut = by_name[parameter.name]
            first[column] = parameter.first_from(billionths(decimal(cut.lower)))
            last[column] = parameter.last_upto(billionths(decimal(cut.upper)))
    return replace(area, first=first, last=last)


def common_area(
    space: ParameterSpace,
    influence_map: InfluenceMap,
    scenarios: Sequence[str],
    given: Indices,
    constrained: Collection[str] = (),
) -> SearchArea:
    """The smallest box that holds, of each parameter, the influential bounds of all scenarios and the sets `given`, shape (n, n_searched).

    Values that the map does not speak of count as influential. Parameters that constraints name, `constrained`, keep their full range: a
    value without influence on the score still decides which values of others are allowed.

    A parameter that influences no scenario is held at the given sets' value, or in the middle of its range if there are none. The texts of
    a choice have no order: it is held, or searched as a whole. Where nothing would be left to search, for no parameter influences any
    scenario, the area is the whole space.
    """
    first, last = full_area(space).first, full_area(space).last
    reason = WholeSpace.ALL_INFLUENTIAL
    for column, parameter in enumerate(space.searched):
        low, high = _common_indices(parameter, influence_map, scenarios, given[:, column].tolist())
        if parameter.name not in constrained:
            first[column], last[column] = low, high
        elif high - low + 1 < parameter.n_values:
            reason = WholeSpace.CONSTRAINED
    area = SearchArea(space, first, last, reason)
    return area if len(area.columns) else full_area(space, WholeSpace.NONE_INFLUENTIAL)


def _common_indices(
    parameter: Parameter, influence_map: InfluenceMap, scenarios: Sequence[str], given: Sequence[int]
) -> tuple[int, int]:
    """Returns the first and the last grid index of a parameter that the common area holds."""
    listed = [influence_map.influence(scenario, parameter.name) for scenario in scenarios]
    shared = influence_map.shares_bounds
    reach = [indices for entry in listed if (indices := _influential_indices(parameter, entry, shares_bounds=shared))]
    reach += _uncovered_indices(parameter, influence_map)
    reach += [(index, index) for index in given]
    middle = (parameter.n_values - 1) // 2
    first, last = min((low for low, _ in reach), default=middle), max((high for _, high in reach), default=middle)
    return (0, parameter.n_values - 1) if parameter.choices and first < last else (first, last)


def _uncovered_indices(parameter: Parameter, influence_map: InfluenceMap) -> list[tuple[int, int]]:
    """The grid indices at either end that the map does not cover, each with the next value that it covers.

    A choice has no ends: if the map lacks one of its texts, every text may matter.
    """
    if parameter.choices:
        analysed = influence_map.choices.get(parameter.name, frozenset(parameter.choices))
        return [] if analysed.issuperset(parameter.choices) else [(0, parameter.n_values - 1)]
    covered = influence_map.ranges.get(parameter.name)
    if covered is None:
        return []
    last = parameter.n_values - 1
    first_covered = parameter.first_from(billionths(covered[0]))
    last_covered = parameter.last_upto(billionths(covered[1]))
    below = [(0, min(first_covered, last))] if first_covered > 0 else []
    return [*below, (max(last_covered, 0), last)] if last_covered < last else below


def _influential_indices(parameter: Parameter, influence: Influence, *, shares_bounds: bool) -> tuple[int, int] | None:
    """The grid indices between the bounds and, on each side that is cut, one that lies in the cut region: the bound's own if it is a value
    of the grid and the map `shares_bounds`, else the next outside. None if nothing is influential here."""
    if not influence.influential:
        return None
    first, last, end = 0, parameter.n_values - 1, parameter.n_values - 1
    if influence.lower is not None:
        bound = billionths(influence.lower)
        first = parameter.first_from(bound)
        if first > end:
            return None
        first -= first > 0 and not (shares_bounds and parameter.last_upto(bound) == first)
    if influence.upper is not None:
        bound = billionths(influence.upper)
        last = parameter.last_upto(bound)
        if last < 0:
            return None
        last += last < end and not (shares_bounds and parameter.first_from(bound) == last)
    return first, last

"""Cut regions of a parameter: non-influential intervals from both ends inwards until the first influential one.

Intervals share their edges, so that every step between neighbouring values lies in exactly one of them: a change between the last value
of one interval and the first of the next cannot be missed. What is cut are the values strictly outside the kept intervals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.parameters import Indices, Parameter, ParameterSpace


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
    problems = [
        Problem(
            "sensitivity.intervals",
            f"{intervals} intervals are finer than the grid of {parameter.name}, which has {parameter.n_values} values",
            f"give at most {fitting}",
        )
        for parameter in space.searched
        if parameter.n_values - 1 < intervals_of(parameter, intervals)
    ]
    if problems:
        raise InvalidInputError(*problems)


@dataclass(frozen=True, slots=True)
class Region:
    """Intervals that may be cut: so many from the lower end (`below`), from the upper end (`above`), or all of them (`whole`)."""

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

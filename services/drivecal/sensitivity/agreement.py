"""Do two influence maps say the same? For reproducibility over samples, seeds and designs, as the authors checked theirs."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from drivecal.contracts.tables import InfluenceRow

Pair = tuple[str, str]
"""Scenario and parameter."""
ROUNDING = 1e-9
"""Bounds are decimals that became floats; differences below this share of a parameter's range come from that."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """`pairs`: how many both maps know. `differences`: both rows of each pair on which they disagree. `only_first`, `only_second`: pairs
    that the other does not know."""

    pairs: int
    differences: tuple[tuple[InfluenceRow, InfluenceRow], ...]
    only_first: tuple[Pair, ...]
    only_second: tuple[Pair, ...]

    @property
    def agreeing(self) -> int:
        """Pairs on which they agree."""
        return self.pairs - len(self.differences)

    @property
    def share(self) -> float | None:
        """`agreeing` of `pairs`; None if they have none in common."""
        return self.agreeing / self.pairs if self.pairs else None

    def document(self) -> dict[str, Any]:
        """Returns a JSON document."""

        def side(row: InfluenceRow) -> dict[str, Any]:
            return row.model_dump(include={"influential", "lower", "upper", "unknown"})

        return {
            "pairs": self.pairs,
            "agreeing": self.agreeing,
            "share": self.share,
            "differences": [
                {"scenario": row.scenario, "parameter": row.parameter, "first": side(row), "second": side(other)}
                for row, other in self.differences
            ],
            "only_first": [list(pair) for pair in self.only_first],
            "only_second": [list(pair) for pair in self.only_second],
        }


def agreement(
    first: Iterable[InfluenceRow],
    second: Iterable[InfluenceRow],
    first_map: Iterable[InfluenceRow] = (),
    second_map: Iterable[InfluenceRow] = (),
) -> Agreement:
    """Compares two maps. They agree on a pair if it is influential in both or in neither, and both bounds differ by at most one interval.

    If `first` and `second` are rows of campaigns, `first_map` and `second_map` are the rows of the maps in their own spaces. Campaigns may
    search narrower ranges, but intervals are parts of the map's range.
    """
    ours, theirs = _by_pair(first), _by_pair(second)
    our_intervals, their_intervals = ours | _by_pair(first_map), theirs | _by_pair(second_map)
    shared = [pair for pair in ours if pair in theirs]
    return Agreement(
        pairs=len(shared),
        differences=tuple(
            (ours[pair], theirs[pair])
            for pair in shared
            if not agree(ours[pair], theirs[pair], (our_intervals[pair], their_intervals[pair]))
        ),
        only_first=tuple(pair for pair in ours if pair not in theirs),
        only_second=tuple(pair for pair in theirs if pair not in ours),
    )


def _by_pair(rows: Iterable[InfluenceRow]) -> dict[Pair, InfluenceRow]:
    return {(row.scenario, row.parameter): row for row in rows}


def agree(first: InfluenceRow, second: InfluenceRow, analysed: tuple[InfluenceRow, InfluenceRow]) -> bool:
    """Returns whether two maps agree on one pair. Bounds may differ by one interval of the coarser analysis, plus half a grid step for the
    rounding of an interval's edge. Without an analysis behind either map, they must be equal. `analysed`: both rows in the maps' spaces."""
    if not (first.influential and second.influential):
        return first.influential == second.influential
    allowed = max(map(_interval, analysed)) + ROUNDING * max(map(_range, analysed))
    return _near(first.lower, second.lower, allowed) and _near(first.upper, second.upper, allowed)


def _near(first: float | None, other: float | None, allowed: float) -> bool:
    return first == other if first is None or other is None else abs(first - other) <= allowed


def _range(row: InfluenceRow) -> float:
    return 0.0 if row.space_lower is None or row.space_upper is None else row.space_upper - row.space_lower


def _interval(row: InfluenceRow) -> float:
    """Returns the width of the analysed intervals, in parameter units; 0 without any. The `row` is in the map's own space."""
    if not row.s_rel_intervals or row.n_values is None:
        return 0.0
    return _range(row) * (1 / len(row.s_rel_intervals) + 0.5 / max(1, row.n_values - 1))

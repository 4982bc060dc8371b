"""Lanes of a corridor as SUMO counts them: edge, index and position of a place."""

from bisect import bisect_right
from itertools import pairwise
from math import inf
from typing import NamedTuple

import numpy as np

from drivecal.domain.roads import Floats
from drivecal.roads.corridor import Corridor


class LanePlace(NamedTuple):
    """A lane and a position along it (m)."""

    edge: str
    lane: int
    position: float


class SumoLanes:
    """The lanes of each track, whose positions are not the corridor's s: SUMO stretches lanes and averages them on curves.

    `totals`: position along all lanes of a track at each station, shape (n, m).
    """

    def __init__(self, corridor: Corridor, stations: Floats, *, joined: bool = False) -> None:
        """`stations`: places on the corridor's line (s, m).

        `joined`: closes gaps between lanes, which networks without lanes inside of junctions have and SUMO's vehicles skip: each lane is
        stretched to the middle of the gap.
        """
        self._bases: list[list[float]] = []
        self._names: list[list[tuple[str, int]]] = []
        columns = []
        for track in corridor.tracks:
            places = [corridor.places[piece.edge, piece.index] for piece in track.lanes]
            bases = np.concatenate([[0.0], np.cumsum([place[-1, 0] for place in places])]).tolist()
            stretches = [place[:, 1] for place in places]
            if joined:
                ends = [place.item(0, 1) for place in places[:1]]
                ends += [0.5 * (before.item(-1, 1) + after.item(0, 1)) for before, after in pairwise(places)]
                ends.append(places[-1].item(-1, 1))
                stretches = [np.interp(s, s[[0, -1]], border) for s, border in zip(stretches, pairwise(ends), strict=True)]
            s = np.maximum.accumulate(np.concatenate(stretches))
            positions = np.concatenate([base + place[:, 0] for base, place in zip(bases, places, strict=False)])
            self._bases.append(bases[:-1])
            self._names.append([(piece.edge, piece.index) for piece in track.lanes])
            columns.append(np.interp(stations, s, positions))
        self.totals: Floats = np.column_stack(columns)

    def ahead(self, edge: str, lane: int, position: float) -> LanePlace:
        """Returns the same place if a lane's `position` is beyond its end: on the lane that follows along its track.

        Positions in junctions, and beyond lanes that are on no track, stay.
        """
        for track, names in enumerate(self._names):
            if (edge, lane) in names:
                there = self.place(track, self._bases[track][names.index((edge, lane))] + position)
                return LanePlace(edge, lane, position) if there.edge.startswith(":") else there
        return LanePlace(edge, lane, position)

    def total(self, stations: Floats, track: int, s: float) -> float:
        """Returns the position at s along all lanes of a track. `stations`: as given at the start."""
        return float(np.interp(s, stations, self.totals[:, track]))

    def place(self, track: int, total: float) -> LanePlace:
        """Returns the place at a position along all lanes of a track."""
        bases = self._bases[track]
        piece = max(bisect_right(bases, total) - 1, 0)
        return LanePlace(*self._names[track][piece], total - bases[piece])

    def end(self, track: int, total: float) -> float:
        """Returns the position along all lanes of a track at which the lane at `total` ends, infinity for the last one."""
        bases = self._bases[track]
        piece = bisect_right(bases, total)
        return bases[piece] if piece < len(bases) else inf

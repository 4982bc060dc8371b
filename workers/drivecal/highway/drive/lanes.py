"""Lanes of a corridor as SUMO counts them: edge, index and position of a place."""

from bisect import bisect_right
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

    `totals`: position along all lanes of a track at each row of the line, shape (n, m).
    """

    def __init__(self, corridor: Corridor) -> None:
        self._bases: list[list[float]] = []
        self._names: list[list[tuple[str, int]]] = []
        columns = []
        for track in corridor.tracks:
            base = 0.0
            bases, s, positions = [], [], []
            for piece in track.lanes:
                places = corridor.places[piece.edge, piece.index]
                bases.append(base)
                s.append(places[:, 1])
                positions.append(base + places[:, 0])
                base += float(places[-1, 0])
            self._bases.append(bases)
            self._names.append([(piece.edge, piece.index) for piece in track.lanes])
            columns.append(np.interp(corridor.line[:, 0], np.maximum.accumulate(np.concatenate(s)), np.concatenate(positions)))
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

    def place(self, track: int, total: float) -> LanePlace:
        """Returns the place at a position along all lanes of a track."""
        bases = self._bases[track]
        piece = max(bisect_right(bases, total) - 1, 0)
        return LanePlace(*self._names[track][piece], total - bases[piece])

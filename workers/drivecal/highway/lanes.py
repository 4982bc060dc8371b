"""Lanes of a corridor as SUMO counts them: edge, index and position of a place."""

from bisect import bisect_right
from typing import NamedTuple

import numpy as np

from drivecal.highway.road import Road


class Along(NamedTuple):
    """A place on a track: lane and position along it (m), and along all of the track's lanes."""

    track: int
    edge: str
    lane: int
    position: float
    total: float


class SumoLanes:
    """The lanes of each track, whose positions are not the corridor's s: SUMO stretches lanes and averages them on curves."""

    def __init__(self, road: Road) -> None:
        self._spacing = float(road.line[1, 0])
        self._bases: list[list[float]] = []
        self._names: list[list[tuple[str, int]]] = []
        self._totals: list[list[float]] = []
        """Position along the track's lanes at each row of the line."""
        for track in road.corridor.tracks:
            base, bases = 0.0, []
            knots, values = [], []
            for piece in track.lanes:
                places = road.corridor.places[piece.edge, piece.index]
                bases.append(base)
                knots.append(places[:, 1])
                values.append(base + places[:, 0])
                base += float(places[-1, 0])
            self._bases.append(bases)
            self._names.append([(piece.edge, piece.index) for piece in track.lanes])
            totals = np.interp(road.line[:, 0], np.maximum.accumulate(np.concatenate(knots)), np.concatenate(values))
            self._totals.append(totals.tolist())

    def along(self, s: float, track: int) -> Along:
        """Returns the place of a track at s of the corridor; its first or last if it is not there."""
        totals, bases = self._totals[track], self._bases[track]
        row = min(max(int(s / self._spacing), 0), len(totals) - 2)
        share = min(max(s / self._spacing - row, 0.0), 1.0)
        total = totals[row] + share * (totals[row + 1] - totals[row])
        piece = max(bisect_right(bases, total) - 1, 0)
        edge, index = self._names[track][piece]
        return Along(track, edge, index, total - bases[piece], total)

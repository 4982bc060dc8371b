"""The road of a run as the arrays of `geometry`, and places on it, also as SUMO counts them."""

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import atan, cos, inf, isnan, sin
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from drivecal.domain.roads import Floats, Road, pose_on
from drivecal.highway.geometry import point, with_directions
from drivecal.roads.corridor import Corridor, LanePiece

SMOOTHING = 5.0
"""Distance (m) to both sides over which the slope of a lane's centre is taken."""


class LanePlace(NamedTuple):
    """A lane and a position along it (m)."""

    edge: str
    lane: int
    position: float


class SumoLanes:
    """The lanes of each track, whose positions are not the corridor's s: SUMO stretches lanes and averages them on curves.

    Networks without lanes inside of junctions have gaps between lanes, which SUMO's vehicles skip: each lane is stretched to the middle of
    the gap. `totals`: position along all lanes of a track at each station, shape (n, m).
    """

    def __init__(self, corridor: Corridor, stations: Floats) -> None:
        """Measures the lanes at `stations`, places on the corridor's line (s, m)."""
        self._bases: list[list[float]] = []
        self._names: list[list[tuple[str, int]]] = []
        self._tracks: dict[tuple[str, int], tuple[int, float]] = {}
        """The first track of each lane, and the position along it at which the lane begins."""
        columns: list[Floats] = []
        for track in corridor.tracks:
            places = [corridor.places[piece.edge, piece.index] for piece in track.lanes]
            bases = np.concatenate([[0.0], np.cumsum([place[-1, 0] for place in places])]).tolist()
            ends = [place.item(0, 1) for place in places[:1]]
            ends += [0.5 * (before.item(-1, 1) + after.item(0, 1)) for before, after in pairwise(places)]
            ends.append(places[-1].item(-1, 1))
            stretches = [
                np.interp(place[:, 1], place[[0, -1], 1], border) for place, border in zip(places, pairwise(ends), strict=True)
            ]
            s = np.maximum.accumulate(np.concatenate(stretches))
            positions = np.concatenate([base + place[:, 0] for base, place in zip(bases, places, strict=False)])
            self._bases.append(bases[:-1])
            self._names.append([(piece.edge, piece.index) for piece in track.lanes])
            for name, base in zip(self._names[-1], bases, strict=False):
                self._tracks.setdefault(name, (len(columns), base))
            columns.append(np.interp(stations, s, positions))
        self.totals: Floats = np.column_stack(columns)

    def along(self, edge: str, lane: int, position: float) -> tuple[int, float]:
        """Returns the track of a lane, and a position along it. Raises KeyError if the lane is on no track."""
        track, base = self._tracks[edge, lane]
        return track, base + position

    def ahead(self, edge: str, lane: int, position: float) -> LanePlace:
        """Returns the same place if a lane's `position` is beyond its end: on the lane that follows along its track.

        Positions in junctions, and beyond lanes that are on no track, stay.
        """
        if (edge, lane) not in self._tracks:
            return LanePlace(edge, lane, position)
        there = self.place(*self.along(edge, lane, position))
        return LanePlace(edge, lane, position) if there.edge.startswith(":") else there

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


class HighwayRoad:
    """A corridor with everything that is looked up in each step. Arrays as in `geometry`."""

    def __init__(
        self,
        corridor: Corridor,
        levels: Mapping[str, tuple[float, float]] = MappingProxyType({}),
        unlimited: Sequence[str] = (),
        carriageway: Road | None = None,
    ) -> None:
        """Tabulates the road.

        Args:
            corridor: the lanes of the route.
            levels: stretches of edges above or below the corridor (`roads.levels`).
            unlimited: ids of the network's lanes that get the scenario's `default_limit` (`roads.limits`).
            carriageway: the equal lanes that the corridor is known as, with the line on which they lie.
        """
        self.corridor, self.levels, self.unlimited = corridor, levels, unlimited
        if carriageway is None:
            line, centres, widths, limits = corridor.line, corridor.centres, corridor.widths, corridor.limits
        else:
            line, lanes = carriageway.line, carriageway.lanes
            centres = np.tile(np.arange(lanes) * carriageway.lane_width, (len(line), 1))
            widths = np.full(centres.shape, carriageway.lane_width)
            starts, speeds = np.array(carriageway.limits).T
            limits = np.tile(speeds[np.searchsorted(starts, line[:, 0], side="right") - 1][:, None], (1, lanes))
        self.line: Floats = with_directions(line)
        self.sumo = SumoLanes(corridor, line[:, 0])
        columns = [centres, widths, limits, slopes(line, centres), self.sumo.totals]
        self.lanes: Floats = np.ascontiguousarray(np.stack(columns, axis=-1))
        self.ends: Floats = np.array([track.end for track in corridor.tracks])
        self.length = corridor.length

    def centre(self, s: float, lane: int) -> tuple[LanePiece, float]:
        """Returns the lane of this index on the edge at s, and d of its centre. Raises InvalidInputError if it is not there."""
        piece = self.corridor.piece(s, lane)
        track, _ = self.sumo.along(piece.edge, piece.index, 0.0)
        return piece, float(np.interp(s, self.line[:, 0], self.lanes[:, track, 0]))

    def front(self, piece: LanePiece, s: float, d: float, length: float) -> LanePlace:
        """Returns SUMO's place of a vehicle whose centre is at (s, d) in this lane."""
        track, begin = self.sumo.along(piece.edge, piece.index, 0.0)
        front = s + 0.5 * length / self.stretch(s, d)
        total = float(np.interp(front, self.line[:, 0], self.lanes[:, track, 4])) + max(front - self.length, 0.0)
        return self.sumo.ahead(piece.edge, piece.index, total - begin)

    def start(self, s: float, d: float) -> tuple[float, float, float]:
        """Returns x, y and heading of a vehicle at (s, d) that drives along its lane."""
        x, y, heading, curvature, _ = pose_on(self.line[:, :5], s)
        track = self.corridor.lane_at(s, d)
        row = min(int(s / self.line[1, 0]), len(self.line) - 1)
        slope = 0.0 if track is None else float(np.nan_to_num(self.lanes[row, track, 3]))
        return x - d * sin(heading), y + d * cos(heading), heading + atan(slope / (1.0 - curvature * d))

    def lateral(self, s: float, d: float, at: float) -> float:
        """Returns d at another s, `at`, of the centre of the lane that holds (s, d); d itself if there is no lane, or it is not there."""
        track = self.corridor.lane_at(s, d)
        if track is None:
            return d
        row = min(max(int(at / self.line[1, 0]), 0), len(self.line) - 1)
        centre = float(self.lanes[row, track, 0])
        return d if isnan(centre) else centre

    def stretch(self, s: float, d: float) -> float:
        """Returns metres of a way through (s, d) along the road per metre of s; 1 without a place."""
        return 1.0 if isnan(s) else max(1.0 - float(point(self.line, s)[3]) * d, 0.1)


def slopes(line: Floats, centres: Floats) -> Floats:
    """Returns the change of each centre per metre, over the rows to both sides that exist; 0 at a row without neighbours."""
    spacing = line[1, 0]
    reach = max(1, round(SMOOTHING / spacing))
    result: Floats = np.full(centres.shape, np.nan)
    for track, centre in enumerate(centres.T):
        rows = np.flatnonzero(~np.isnan(centre))
        if not len(rows):
            continue
        before, after = np.maximum(rows - reach, rows[0]), np.minimum(rows + reach, rows[-1])
        result[rows, track] = (centre[after] - centre[before]) / (np.maximum(after - before, 1) * spacing)
    return result

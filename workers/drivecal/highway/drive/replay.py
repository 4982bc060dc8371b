"""Replays of drives: the ego vehicle, the others near it and the surface of its route, in the coordinates of the network."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import ceil, floor

import numpy as np
import numpy.typing as npt

from drivecal.contracts.evaluation import LaneStrip, ReplayAnswer, ReplayEgo, ReplayVehicle, RoadSurface
from drivecal.domain.roads import Floats
from drivecal.highway.drive.geometry import moved_on
from drivecal.highway.drive.measures import Record
from drivecal.highway.drive.traffic import Traffic
from drivecal.roads.corridor import Corridor
from drivecal.roads.lines import lengths

REACH = 250.0
"""Distance (m) from the ego vehicle up to which vehicles and roads are recorded: more than a view shows."""
PERIOD = 0.1
"""Shortest time (s) between two recorded moments, but for the last."""
MOST_MOMENTS, MOST_POSES = 10_000, 150_000
"""Limits of the recorded moments and of the poses of other vehicles. Longer and fuller runs are recorded at fewer moments."""
LENGTHS, ANGLES = 2, 4
"""Digits of lengths (m) and angles (rad)."""
TOLERANCE = 0.03
"""Largest distance (m) from a border to its simplified polyline."""
LONGEST = 100.0
"""Largest distance (m) between two points of a polyline, so that a view finds some on each stretch that it shows."""
LINE_SPACING = 5.0
"""Metres between the points of the route's line."""
SAME = 0.6
"""Largest distance (m) between the borders of two lanes that share one."""
Moment = tuple[list[str], Floats]
"""Names and outlines of the vehicles near the ego vehicle."""
EGO = ("x_m", "y_m", "heading_rad", "speed_mps", "position_m", "offset_m")


class DriveRecorder:
    """The watcher of one run, whose memory is bounded."""

    def __init__(self, step: float) -> None:
        """`step`: time (s) between two moments."""
        self._every = max(1, ceil(PERIOD / step - 1e-9))
        """Number of steps between two kept moments. It doubles whenever these reach a limit."""
        self._moments: list[Moment] = []
        """The moments 0, `_every`, 2 `_every`, ... of the start and after each step of the traffic."""
        self._newest: Moment = [], np.zeros((0, 7))
        self._seen = self._poses = 0
        """Number of all moments so far, and of the poses in the kept ones."""

    def __call__(self, traffic: Traffic, pose: Floats, *_: Floats | None) -> None:
        names, outlines = traffic.names, traffic.outlines
        near = np.flatnonzero(np.hypot(outlines[:, 0] - pose[0], outlines[:, 1] - pose[1]) <= REACH)
        self._newest = [names[row] for row in near.tolist()], outlines[near]
        if self._seen % self._every == 0:
            self._moments.append(self._newest)
            self._poses += len(near)
            while len(self._moments) > 1 and (len(self._moments) > MOST_MOMENTS or self._poses > MOST_POSES):
                self._every *= 2
                self._moments = self._moments[::2]
                self._poses = sum(len(kept) for kept, _ in self._moments)
        self._seen += 1

    def replay(self, record: Record, length: float, corridor: Corridor) -> ReplayAnswer | None:
        """Returns the run on its route; None if the vehicle has no place at two moments. `length` is the ego vehicle's (m)."""
        ego = np.column_stack([record.column(name) for name in EGO])
        count = int(np.argmin(np.append(np.isfinite(ego).all(axis=1), False)))  # an unstable vehicle may have no place
        if count < 2:
            return None
        times, ego = record.column("time_s")[:count], ego[:count]
        moments = dict(zip(range(0, count, self._every), self._moments, strict=False))
        if self._seen == count:
            moments[count - 1] = self._newest
        elif self._seen < count:  # the run ended within a step of the traffic
            names, outlines = self._newest
            moments[count - 1] = names, moved_on(outlines, times.item(-1) - times.item(self._seen - 1))
        shown = list(moments)
        if len(shown) < 2:
            return None
        position = ego[:, EGO.index("position_m")]
        rows = rows_between(corridor, position.min() - REACH, position.max() + REACH)
        columns = {
            name: ego[shown, place].round(ANGLES if name == "heading_rad" else LENGTHS).tolist()
            for place, name in enumerate(EGO)
        }
        return ReplayAnswer(
            time_s=times[shown].round(ANGLES).tolist(),
            line=line_of(corridor, rows),
            route=route_surface(corridor, rows),
            ego=ReplayEgo(length_m=length, width_m=record.width, **columns),
            others=_vehicles(list(moments.values())),
        )


def _vehicles(moments: Sequence[Moment]) -> list[ReplayVehicle]:
    """Returns each vehicle for each time that it is there without a gap."""
    vehicles: list[ReplayVehicle] = []
    here: dict[str, ReplayVehicle] = {}
    for number, (names, outlines) in enumerate(moments):
        before, here = here, {}
        poses = np.column_stack([outlines[:, :2].round(LENGTHS), outlines[:, 2].round(ANGLES)]).tolist()
        for name, (x, y, heading), (half_length, half_width) in zip(names, poses, outlines[:, 3:5].tolist(), strict=True):
            vehicle = before.get(name)
            if vehicle is None:
                size = {"length_m": 2.0 * half_length, "width_m": 2.0 * half_width}
                vehicle = ReplayVehicle(id=name, first=number, x_m=[], y_m=[], heading_rad=[], **size)
                vehicles.append(vehicle)
            here[name] = vehicle
            vehicle.x_m.append(x)
            vehicle.y_m.append(y)
            vehicle.heading_rad.append(heading)
    return vehicles


def rows_between(corridor: Corridor, first: float, last: float) -> slice:
    """Returns the rows of the line from s = `first` to `last`, at least two."""
    spacing, count = corridor.line.item(1, 0), len(corridor.line)
    begin = min(max(floor(first / spacing), 0), count - 2)
    return slice(begin, max(min(ceil(last / spacing) + 1, count), begin + 2))


def line_of(corridor: Corridor, rows: slice) -> list[list[float]]:
    """Returns place, x, y and heading along the route."""
    line = corridor.line[rows]
    chosen = np.unique(np.r_[0 : len(line) : max(1, round(LINE_SPACING / corridor.line.item(1, 0))), len(line) - 1])
    return np.column_stack([line[chosen, :3].round(LENGTHS), line[chosen, 3].round(ANGLES)]).tolist()


def route_surface(corridor: Corridor, rows: slice) -> RoadSurface:
    """Returns the lanes of the route. A border of two lanes is a marking; one inside of another lane, where two join, is not drawn."""
    line, half = corridor.line[rows], 0.5 * corridor.widths[rows]
    right, left = corridor.centres[rows] - half, corridor.centres[rows] + half
    surface = RoadSurface(lanes=[], edges=[], markings=[])
    for track in range(right.shape[1]):
        exists = ~np.isnan(right[:, track])
        borders = _points(line, right[:, track]), _points(line, left[:, track])
        for run in _runs(exists):
            # A lane begins and ends between two rows: one more row leaves no gap to the lane before or behind it.
            longer = np.arange(max(run.start - 1, 0), min(run.stop + 1, len(line)))
            known = np.clip(longer, run.start, run.stop - 1)
            surface.lanes.append(_strip(_points(line[longer], right[known, track]), _points(line[longer], left[known, track])))
        for border, side, facing in ((0, right[:, track], left), (1, left[:, track], right)):
            others = np.arange(right.shape[1]) != track
            shared = (np.abs(facing[:, others] - side[:, None]) <= SAME).any(axis=1)
            covered = (right[:, others] + SAME < side[:, None]) & (side[:, None] < left[:, others] - SAME)
            is_edge = exists & ~shared & ~covered.any(axis=1)
            surface.edges.extend(_polyline(borders[border][run]) for run in _runs(is_edge))
            if border == 1:  # the right border of its neighbour is the same one
                is_marking = exists & shared & ~covered.any(axis=1)
                surface.markings.extend(_polyline(borders[border][run]) for run in _runs(is_marking))
    return surface


def simplified(points: Floats) -> Floats:
    """Returns rows of a polyline (n, k) from which the rest differs by at most `TOLERANCE`, at most `LONGEST` apart.

    The first two columns are x and y; all columns are kept within the tolerance (Douglas and Peucker 1973).
    """
    s = lengths(points[:, :2])
    kept = {0, len(points) - 1} | set(np.unique((s // (0.9 * LONGEST)).astype(np.int64), return_index=True)[1].tolist())
    ends = sorted(kept)
    open_ = list(pairwise(ends))
    while open_:
        first, last = open_.pop()
        if last - first < 2:
            continue
        span = slice(first + 1, last)
        share = (s[span] - s[first]) / max(s.item(last) - s.item(first), 1e-9)
        off = np.abs(points[first] + share[:, None] * (points[last] - points[first]) - points[span]).max(axis=1)
        if off.max() > TOLERANCE:
            worst = first + 1 + int(off.argmax())
            kept.add(worst)
            open_ += [(first, worst), (worst, last)]
    return points[sorted(kept)]


def _points(line: Floats, d: Floats) -> Floats:
    """Returns the points (n, 2) at the offsets d of a line's rows."""
    return line[:, 1:3] + d[:, None] * np.column_stack([-np.sin(line[:, 3]), np.cos(line[:, 3])])


def _strip(right: Floats, left: Floats) -> LaneStrip:
    rows = simplified(np.hstack([right, left])).round(LENGTHS)
    return LaneStrip(right=rows[:, :2].tolist(), left=rows[:, 2:].tolist())


def _polyline(points: Floats) -> list[list[float]]:
    rows: list[list[float]] = simplified(points).round(LENGTHS).tolist()
    return rows


def _runs(there: npt.NDArray[np.bool_]) -> Iterator[slice]:
    """Yields the stretches of at least two rows that are there."""
    changes = np.flatnonzero(np.diff(np.concatenate([[False], there, [False]]).astype(np.int8)))
    for begin, end in changes.reshape(-1, 2).tolist():
        if end - begin > 1:
            yield slice(begin, end)

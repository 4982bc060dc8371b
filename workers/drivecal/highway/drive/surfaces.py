"""Surface of a route in the coordinates of the network: areas of its lanes, edges, markings between lanes."""

from collections.abc import Iterator
from itertools import pairwise
from math import ceil, floor

import numpy as np
import numpy.typing as npt

from drivecal.contracts.evaluation import LaneStrip, RoadSurface
from drivecal.domain.roads import Floats
from drivecal.roads.corridor import Corridor
from drivecal.roads.lines import lengths

TOLERANCE = 0.03
"""Largest distance (m) from a border to its simplified polyline."""
LONGEST = 100.0
"""Largest distance (m) between two points of a polyline, so that a view finds some on each stretch that it shows."""
LINE_SPACING = 5.0
"""Metres between the points of the route's line."""
SAME = 0.6
"""Largest distance (m) between the borders of two lanes that share one."""
DIGITS = 2


def rows_between(corridor: Corridor, first: float, last: float) -> slice:
    """Returns the rows of the line from s = `first` to `last`, at least two."""
    spacing, count = corridor.line.item(1, 0), len(corridor.line)
    begin = min(max(floor(first / spacing), 0), count - 2)
    return slice(begin, max(min(ceil(last / spacing) + 1, count), begin + 2))


def line_of(corridor: Corridor, rows: slice) -> list[list[float]]:
    """Returns place, x, y and heading along the route."""
    line = corridor.line[rows]
    chosen = np.unique(np.r_[0 : len(line) : max(1, round(LINE_SPACING / corridor.line.item(1, 0))), len(line) - 1])
    return np.column_stack([line[chosen, :3].round(DIGITS), line[chosen, 3].round(4)]).tolist()


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
    rows = simplified(np.hstack([right, left])).round(DIGITS)
    return LaneStrip(right=rows[:, :2].tolist(), left=rows[:, 2:].tolist())


def _polyline(points: Floats) -> list[list[float]]:
    rows: list[list[float]] = simplified(points).round(DIGITS).tolist()
    return rows


def _runs(there: npt.NDArray[np.bool_]) -> Iterator[slice]:
    """Yields the stretches of at least two rows that are there."""
    changes = np.flatnonzero(np.diff(np.concatenate([[False], there, [False]]).astype(np.int8)))
    for begin, end in changes.reshape(-1, 2).tolist():
        if end - begin > 1:
            yield slice(begin, end)

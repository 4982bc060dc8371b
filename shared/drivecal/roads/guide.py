"""The reference line of a route: its guide's lanes, joined and smoothed."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.roads import Floats
from drivecal.roads.lines import along, lengths, nodes_of, project, smoothed, table
from drivecal.roads.network import Lane, Network
from drivecal.roads.route import Lanes, refusal

TOLERANCE = 0.09
"""Metres between the line and the file's points, before rounding."""
FASTEST_TURN = 8.0
"""Lateral acceleration (m/s²) at the speed limit that no car reaches: the line leaves short corners that ask for more."""
SLOWEST, FASTEST = 5.0, 36.0
"""Speeds (m/s) between which limits count there."""
SMALLEST_RADIUS = 30.0
"""Metres."""
SHORTEST_TURN = 20.0
"""Metres. Longer turns are the road's own."""
AROUND = 25.0
"""Metres before and after such a corner in which the line leaves the lane."""
WIDENINGS = 10
"""Times that the tolerance grows by half there, at most."""
LARGEST_GAP = 100.0
"""Metres between lanes that follow each other."""
SHORTEST, LONGEST = 10.0, 100_000.0
"""Metres of a route."""


@dataclass(frozen=True, eq=False)
class Guide:
    """A reference line and, for each edge of the route, about where it begins and ends (s, m)."""

    line: Floats
    ranges: tuple[tuple[float, float], ...]
    left: tuple[tuple[float, float], ...]
    """Ranges of s in which the line is farther than the tolerance from the guide's lanes, apart from lane changes."""


def guide_of(network: Network, lanes: Lanes) -> Guide:
    """Returns the reference line of a route's lanes. Raises InvalidInputError if lanes have gaps, or the route is too short."""
    joined = _Joined(network)
    borders: list[tuple[int, int]] = []
    for index, (begin, end) in enumerate(lanes.guide):
        first = joined.append(begin, begin.shape if begin is end else _blended(begin, end), index)
        borders.append((first, joined.count - 1))
        if index < len(lanes.passages):
            for lane in lanes.passages[index]:
                joined.append(lane, lane.shape, index)
    points, limits = joined.result()
    length = lengths(points)
    if not SHORTEST <= length[-1] <= LONGEST:
        message = f"{network.name}: the route is {length[-1]:.1f} m long"
        raise InvalidInputError(Problem("route", message, f"give one of {SHORTEST:g} to {LONGEST:,.0f} m"))
    nodes = nodes_of(points)
    at = np.clip(np.searchsorted(length, lengths(nodes), side="left"), 0, len(limits) - 1)
    line, left = _drivable(nodes, limits[at])
    ends = points[[place for border in borders for place in border]]
    guess = length[[place for border in borders for place in border]]
    s, _ = project(line, ends, guess)
    s = np.where(np.isnan(s), guess, s).reshape(-1, 2)
    return Guide(line, tuple((float(begin), float(end)) for begin, end in s), left)


class _Joined:
    """Polylines joined to one, without points that step back."""

    def __init__(self, network: Network) -> None:
        self._network = network
        self._points: list[Floats] = []
        self._limits: list[Floats] = []
        self._last: Floats | None = None
        self.count = 0

    def append(self, lane: Lane, shape: Floats, index: int) -> int:
        """Adds the points of a lane, or of a change from it; returns the index of the first."""
        kept = shape
        if self._last is not None:
            gap = float(np.hypot(*(shape[0] - self._last)))
            if gap > LARGEST_GAP:
                where = f"line {lane.line}, the lane {shown(f'{lane.edge}_{lane.index}', 90)}"
                message = f"{where} begins {gap:.1f} m away from the end of the one before it"
                raise refusal(index, self._network, message, "build the network again")
            direction = _direction(shape)
            ahead = (shape - self._last) @ direction > 0.05
            kept = shape[int(np.argmax(ahead)) :] if ahead.any() else shape[:0]
        steps = np.hypot(*np.diff(kept, axis=0).T) if len(kept) > 1 else np.zeros(0)
        kept = kept[np.concatenate([[True], steps > 1e-3])] if len(kept) else kept
        # a lane whose first point is the last of the lane before begins there
        first = self.count if len(kept) == len(shape) else max(0, self.count - 1)
        if len(kept):
            self._points.append(kept)
            self._limits.append(np.full(len(kept), lane.limit))
            self._last = kept[-1]
            self.count += len(kept)
        return first

    def result(self) -> tuple[Floats, Floats]:
        """Returns the points (n, 2) and the speed limit at each (n,)."""
        return np.vstack(self._points), np.concatenate(self._limits)


def _direction(shape: Floats) -> Floats:
    """Returns the unit vector in which a lane starts, zero if it is a point."""
    steps = shape[1:] - shape[0]
    far = np.hypot(*steps.T)
    index = int(np.argmax(far > min(1.0, far.max())))
    return np.asarray(steps[index] / far[index] if far[index] > 0 else np.zeros(2))


def _blended(begin: Lane, end: Lane) -> Floats:
    """Returns points of a smooth lane change along the whole of an edge."""
    count = max(16, int(lengths(begin.shape)[-1]))
    share = np.linspace(0.0, 1.0, count)
    first, second = (along(lane.shape, share * lengths(lane.shape)[-1]) for lane in (begin, end))
    weight = (share**3 * (10.0 - 15.0 * share + 6.0 * share**2))[:, None]
    return np.asarray((1.0 - weight) * first + weight * second)


def _drivable(nodes: Floats, limits: Floats) -> tuple[Floats, tuple[tuple[float, float], ...]]:
    """Returns the line through nodes (n, 2), and the ranges in which it leaves them for want of a curve that can be driven.

    It leaves them only if that helps: around corners that nothing makes fit for the limit, it stays as long as their radius is not below
    `SMALLEST_RADIUS`.
    """
    s = lengths(nodes)
    drivable = FASTEST_TURN / np.clip(limits, SLOWEST, FASTEST) ** 2
    line, tolerance, hopeless = _widened(nodes, np.full(len(nodes), TOLERANCE), drivable)
    if hopeless.any():
        base = np.where(hopeless, TOLERANCE, tolerance)
        line, tolerance, _ = _widened(nodes, base, np.maximum(drivable, 1.0 / SMALLEST_RADIUS))
    return line, _runs(s, tolerance > TOLERANCE)


def _widened(nodes: Floats, tolerance: Floats, most: Floats) -> tuple[Floats, Floats, npt.NDArray[np.bool_]]:
    """Returns a line whose short turns have at most the curvature `most` (n,), the tolerance (n,) that it takes, and where none does."""
    s, tolerance = lengths(nodes), tolerance.copy()
    for widening in range(WIDENINGS + 1):
        line = table(smoothed(nodes, tolerance))
        excess = np.abs(line[:, 4]) > np.interp(line[:, 0], s, most)
        around = np.zeros(len(nodes), np.bool_)
        for begin, end in _runs(line[:, 0], excess):
            if end - begin < SHORTEST_TURN:
                around |= (s >= begin - AROUND) & (s <= end + AROUND)
        if not around.any() or widening == WIDENINGS:
            break
        tolerance[around] *= 1.5
    return line, tolerance, around


def _runs(s: Floats, inside: npt.NDArray[np.bool_]) -> tuple[tuple[float, float], ...]:
    """Returns first and last s of each run of true values."""
    borders = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(np.int8), [0]])))
    return tuple((float(s[first]), float(s[last - 1])) for first, last in borders.reshape(-1, 2))

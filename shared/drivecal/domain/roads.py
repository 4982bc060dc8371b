"""Geometry of the reference line: its table, and Cartesian coordinates of places on the road.

A reference line is a table of shape (n, 5) with the columns s, x, y, heading, curvature (m, rad, 1/m), uniformly spaced in s.
Between its rows curvature is linear, heading its exact integral and x, y the cubic that fits points and headings. Before the first
row and beyond the last row the road is straight.
"""

from dataclasses import dataclass
from math import ceil, cos, sin

import numpy as np
import numpy.typing as npt

from drivecal.domain.errors import InvalidInputError, Problem

Floats = npt.NDArray[np.float64]

GAUSS_POINTS, GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True, slots=True, eq=False)
class Road:
    """A motorway carriageway of equal lanes, as its network has it: `drivecal.roads.carriageway` measures it.

    `line`, shape (n, 5): the reference line, as in `domain.roads`; `length` is the length of the route along it.
    """

    line: Floats
    length: float
    lanes: int
    lane_width: float
    limits: tuple[tuple[float, float], ...] = ()
    """Pairs of s (m) and the limit (m/s) behind it, the first at s = 0. The other vehicles obey them."""

    @property
    def right_edge(self) -> float:
        """Offset d of the right boundary."""
        return -0.5 * self.lane_width

    @property
    def left_edge(self) -> float:
        """Offset d of the left boundary."""
        return (self.lanes - 0.5) * self.lane_width


def reference_line(road: Road, spacing: float = 0.5) -> Floats:
    """Returns the table of a road's reference line, shape (n, 5): s, x, y, heading, curvature.

    Rows are `spacing` metres apart; the last row is the first at or beyond the road's length.
    """
    return resampled(road.line, road.length, spacing)


def resampled(line: Floats, length: float, spacing: float) -> Floats:
    """Returns a reference line from 0 to `length` in rows `spacing` metres apart; itself if it is that.

    Curvature, x and y are the same as of `pose_on`; heading is the integral of the new rows' linear curvature. Raises InvalidInputError
    if length or spacing are not positive.
    """
    if not length > 0 or not spacing > 0:
        raise InvalidInputError(Problem("road.length", f"{length} m in rows of {spacing} m", "both must be positive"))
    s = np.arange(ceil(length / spacing - 1e-6) + 1) * spacing
    if np.array_equal(line[:, 0], s):
        return line
    x, y, _, curvature, _ = np.array([pose_on(line, station) for station in s.tolist()]).T
    turned = np.cumsum(0.5 * (curvature[:-1] + curvature[1:])) * spacing
    return np.column_stack([s, x, y, line[0, 3] + np.concatenate([[0.0], turned]), curvature])


def pose_on(line: Floats, s: float) -> tuple[float, float, float, float, float]:
    """Returns x, y, heading, curvature and change of curvature (1/m²) of the reference line at arc length s."""
    spacing = line.item(1, 0)
    last = len(line) - 1
    if s < 0 or s > last * spacing:
        row, ahead = (0, s) if s < 0 else (last, s - last * spacing)
        _, x, y, heading, _ = line[row].tolist()
        return x + ahead * cos(heading), y + ahead * sin(heading), heading, 0.0, 0.0
    row = min(int(s / spacing), last - 1)
    (s0, x0, y0, heading0, curvature0), (_, x1, y1, heading1, curvature1) = line[row : row + 2].tolist()
    u = s - s0
    bend = (curvature1 - curvature0) / spacing
    w = u / spacing
    from_start, from_end = w * (1 - w) ** 2 * spacing, w * w * (w - 1) * spacing
    blend = w * w * (3 - 2 * w)
    x = x0 + blend * (x1 - x0) + from_start * cos(heading0) + from_end * cos(heading1)
    y = y0 + blend * (y1 - y0) + from_start * sin(heading0) + from_end * sin(heading1)
    return x, y, heading0 + u * (curvature0 + 0.5 * bend * u), curvature0 + bend * u, bend

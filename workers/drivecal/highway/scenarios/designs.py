"""Designs of the roads of S1..S6, from which `build` makes their networks. Runs know the networks only.

Roads follow the usual design: 3.75 m lanes, clothoids between straights and arcs.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil
from types import MappingProxyType

import numpy as np

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.roads import GAUSS_POINTS, GAUSS_WEIGHTS, Floats
from drivecal.domain.scenarios import SpeedKnot

LANE_WIDTH = 3.75


@dataclass(frozen=True, slots=True)
class CurvatureKnot:
    """Curvature (1/m, positive to the left) of the reference line at arc length s; linear between knots: clothoids and arcs."""

    s: float
    curvature: float


@dataclass(frozen=True, slots=True)
class RoadDesign:
    """Design of a carriageway: `lanes` lanes of `lane_width` metres along the centre line of the rightmost, given by its curvature."""

    length: float
    lanes: int
    lane_width: float
    knots: tuple[CurvatureKnot, ...]
    limits: tuple[SpeedKnot, ...] = (SpeedKnot(0.0, 130.0 / 3.6),)
    """Speed limits, the first at s = 0. Each is an edge of the network."""

    @property
    def left_edge(self) -> float:
        """Offset d of the left boundary."""
        return (self.lanes - 0.5) * self.lane_width


def line_of(design: RoadDesign, spacing: float = 0.5) -> Floats:
    """Returns the table of a design's reference line from (0, 0, 0) at heading 0, shape (n, 5): s, x, y, heading, curvature.

    Rows are `spacing` metres apart; the last row is the first at or beyond the road's length. Curvature is constant outside
    the knots. Heading is exact; x and y come from five-point Gauss-Legendre quadrature between neighbouring rows and knots:
    rounding error only (below 1e-9 m per kilometre) while the heading changes by less than 0.1 rad per row.

    Raises InvalidInputError if length or spacing are not positive, or the knots are not in order.
    """
    if not design.length > 0 or not spacing > 0:
        raise InvalidInputError(Problem("length", f"{design.length} m in rows of {spacing} m", "both must be positive"))
    knot_s = np.array([knot.s for knot in design.knots])
    knot_curvature = np.array([knot.curvature for knot in design.knots])
    if not knot_s.size or np.any(np.diff(knot_s) <= 0):
        raise InvalidInputError(Problem("knots", "there must be knots in order of s", "give each knot a larger s"))

    s = np.arange(ceil(design.length / spacing - 1e-9) + 1) * spacing
    edges = np.union1d(s, knot_s[(knot_s > 0) & (knot_s < s[-1])])
    curvature = np.interp(edges, knot_s, knot_curvature)
    length = np.diff(edges)
    heading = np.concatenate([[0.0], np.cumsum(0.5 * (curvature[:-1] + curvature[1:]) * length)])

    along = 0.5 * (1.0 + GAUSS_POINTS) * length[:, None]
    bend = np.diff(curvature) / length
    angle = heading[:-1, None] + curvature[:-1, None] * along + 0.5 * bend[:, None] * along**2
    step = 0.5 * length[:, None] * (np.stack([np.cos(angle), np.sin(angle)]) @ GAUSS_WEIGHTS[:, None])[..., 0].T
    position = np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)])

    rows = np.searchsorted(edges, s)
    return np.column_stack([s, position[rows], heading[rows], curvature[rows]])


def kmh(speed: float) -> float:
    """Converts km/h to m/s."""
    return speed / 3.6


def straight(length: float, *limits: tuple[float, float]) -> RoadDesign:
    """Returns a straight road; `limits` are (s, km/h)."""
    return road(length, (CurvatureKnot(0.0, 0.0), CurvatureKnot(length, 0.0)), *limits)


def road(length: float, knots: tuple[CurvatureKnot, ...], *limits: tuple[float, float]) -> RoadDesign:
    """Returns a three-lane road; `limits` are (s, km/h)."""
    return RoadDesign(length, 3, LANE_WIDTH, knots, tuple(SpeedKnot(s, kmh(speed)) for s, speed in limits))


def bends(length: float, *arcs: tuple[float, float, float, float]) -> tuple[CurvatureKnot, ...]:
    """Returns the curvature knots of a road of straights, clothoids and arcs.

    Each arc is (begin of its first clothoid, length of either clothoid, length of the arc between them, radius); positive radii bend to the
    left.
    """
    knots = [CurvatureKnot(0.0, 0.0)]
    for begin, clothoid, arc, radius in arcs:
        knots.append(CurvatureKnot(begin, 0.0))
        knots.append(CurvatureKnot(begin + clothoid, 1.0 / radius))
        knots.append(CurvatureKnot(begin + clothoid + arc, 1.0 / radius))
        knots.append(CurvatureKnot(begin + 2.0 * clothoid + arc, 0.0))
    knots.append(CurvatureKnot(length, 0.0))
    return tuple(knots)


DESIGNS: Mapping[str, RoadDesign] = MappingProxyType(
    {
        "S1": straight(1100.0, (0.0, 130.0)),
        "S2": road(1100.0, bends(1100.0, (180.0, 120.0, 500.0, 1000.0)), (0.0, 120.0)),
        "S3": straight(1100.0, (0.0, 130.0)),
        "S4": road(1200.0, bends(1200.0, (200.0, 110.0, 120.0, 850.0), (560.0, 110.0, 120.0, -850.0)), (0.0, 120.0)),
        "S5": straight(1200.0, (0.0, 80.0), (230.0, 120.0)),
        "S6": road(1100.0, bends(1100.0, (265.0, 80.0, 350.0, 480.0)), (0.0, 130.0), (275.0, 85.0)),
    }
)
"""By scenario."""

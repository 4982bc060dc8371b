"""Roads for tests, computed from their curvature in the place of a network."""

from dataclasses import dataclass
from math import ceil, cos, sin

import numpy as np

from drivecal.domain.roads import GAUSS_POINTS, GAUSS_WEIGHTS, Floats, Road, pose_on


@dataclass(frozen=True, slots=True)
class CurvatureKnot:
    """Curvature (1/m, positive to the left) of the reference line at arc length s; linear between knots: clothoids and arcs."""

    s: float
    curvature: float


@dataclass(frozen=True, slots=True)
class RoadDesign:
    """A carriageway: `lanes` lanes of `lane_width` metres along the centre line of the rightmost."""

    length: float
    lanes: int
    lane_width: float
    knots: tuple[CurvatureKnot, ...]


def line_of(design: RoadDesign, spacing: float = 0.5) -> Floats:
    """The table of the reference line from (0, 0, 0), shape (n, 5): s, x, y, heading, curvature; exact but for rounding."""
    knot_s = np.array([knot.s for knot in design.knots])
    s = np.arange(ceil(design.length / spacing - 1e-9) + 1) * spacing
    edges = np.union1d(s, knot_s[(knot_s > 0) & (knot_s < s[-1])])
    curvature = np.interp(edges, knot_s, [knot.curvature for knot in design.knots])
    length, bend = np.diff(edges), np.diff(curvature) / np.diff(edges)
    heading = np.concatenate([[0.0], np.cumsum(0.5 * (curvature[:-1] + curvature[1:]) * length)])
    along = 0.5 * (1.0 + GAUSS_POINTS) * length[:, None]
    angle = heading[:-1, None] + curvature[:-1, None] * along + 0.5 * bend[:, None] * along**2
    step = 0.5 * length[:, None] * (np.stack([np.cos(angle), np.sin(angle)]) @ GAUSS_WEIGHTS[:, None])[..., 0].T
    position = np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)])
    rows = np.searchsorted(edges, s)
    return np.column_stack([s, position[rows], heading[rows], curvature[rows]])


def road_of(length: float, lanes: int, lane_width: float, knots: tuple[CurvatureKnot, ...]) -> Road:
    return Road(line_of(RoadDesign(length, lanes, lane_width, knots)), length, lanes, lane_width)


def to_cartesian(line: Floats, s: float, d: float) -> tuple[float, float, float]:
    """Returns x, y of the point at (s, d) and the heading of the road there."""
    x, y, heading, _, _ = pose_on(line, s)
    return x - d * sin(heading), y + d * cos(heading), heading

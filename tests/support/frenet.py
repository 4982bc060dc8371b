"""Frenet coordinates of points and motions (Werling et al. 2010), in plain Python: the oracle of the compiled kernels."""

from math import cos, isfinite, sin
from typing import NamedTuple

from drivecal.domain.roads import Floats, pose_on

PROJECTION_TOLERANCE = 1e-10
PROJECTION_STEPS = 30
FARTHEST_STEP = 200.0
"""Largest step (m) of the search; a larger step means a wrong guess."""


class Motion(NamedTuple):
    """A vehicle's motion in Frenet coordinates: s along the reference line, d to its left, derivatives by time, SI units."""

    s: float
    s_dot: float
    s_ddot: float
    d: float
    d_dot: float
    d_ddot: float


def _foot(line: Floats, x: float, y: float, near: float) -> tuple[float, float, float, float, float]:
    """s, d and the line's heading, curvature and change of curvature at the foot point of (x, y): see `project`."""
    s = near
    for _ in range(PROJECTION_STEPS if isfinite(x + y + near) else 0):
        foot_x, foot_y, heading, curvature, bend = pose_on(line, s)
        dx, dy = x - foot_x, y - foot_y
        forward, left = cos(heading), sin(heading)
        d = dy * forward - dx * left
        step = (dx * forward + dy * left) / max(1.0 - curvature * d, 0.1)
        if abs(step) < PROJECTION_TOLERANCE:
            return s, d, heading, curvature, bend
        if not abs(step) < FARTHEST_STEP:
            break
        s += step
    raise ValueError(f"({x}, {y}) has no foot point on the reference line near s = {near}; give a closer `near`")


def project(line: Floats, x: float, y: float, near: float) -> tuple[float, float]:
    """Returns s and d of the point on the reference line closest to (x, y), searched by Newton's method from s = `near`.

    Exact to about 1e-9 m. Returns the right foot point if `near` is within some tens of metres and the point lies inside the
    circle of curvature. Raises ValueError if the search does not converge: the point is far from the line at `near`.
    """
    s, d, _, _, _ = _foot(line, x, y, near)
    return s, d


def to_frenet(
    line: Floats, position: tuple[float, float], velocity: tuple[float, float], acceleration: tuple[float, float], near: float
) -> Motion:
    """Returns the Frenet motion of a point with Cartesian position, velocity and acceleration (SI); `near` and errors as in `project`.

    From r = r0(s) + d n with Frenet's formulas: v_t = s' (1 - κd), v_n = d', a_t = s'' (1 - κd) - s' (κ' s' d + 2 κ d'),
    a_n = d'' + κ s'² (1 - κd), κ' by arc length.
    """
    s, d, heading, curvature, bend = _foot(line, *position, near)
    forward, left = cos(heading), sin(heading)
    stretch = 1.0 - curvature * d
    s_dot = (velocity[0] * forward + velocity[1] * left) / stretch
    d_dot = velocity[1] * forward - velocity[0] * left
    tangential = acceleration[0] * forward + acceleration[1] * left
    normal = acceleration[1] * forward - acceleration[0] * left
    s_ddot = (tangential + s_dot * (bend * s_dot * d + 2.0 * curvature * d_dot)) / stretch
    d_ddot = normal - curvature * s_dot * s_dot * stretch
    return Motion(s, s_dot, s_ddot, d, d_dot, d_ddot)

"""Reference lines through the points of a file: smooth within a tolerance, and projections of many points onto them.

A line is a table as in `drivecal.domain.roads`: s, x, y, heading, curvature, equally spaced.
"""

from math import ceil

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.linalg import solveh_banded

from drivecal.domain.roads import GAUSS_POINTS, GAUSS_WEIGHTS, Floats

SPACING = 0.5
"""Largest distance (m) of the table's rows."""
NODE_SPACING = 1.0
SMOOTHING_LENGTH = 10.0
"""Metres. Waves of a polyline shorter than some six times of it, such as its corners, are smoothed away where the tolerance allows."""
ROUNDS = 60
"""Most rounds that give more weight to points outside the tolerance."""
PROJECTION_ROUNDS = 40
PROJECTION_TOLERANCE = 1e-9


def lengths(points: Floats) -> Floats:
    """Returns the length (m) of a polyline (n, 2) up to each of its points."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def along(points: Floats, positions: Floats) -> Floats:
    """Returns the points (k, 2) of a polyline at lengths from its start."""
    s = lengths(points)
    return np.column_stack([np.interp(positions, s, points[:, 0]), np.interp(positions, s, points[:, 1])])


def nodes_of(points: Floats, spacing: float = NODE_SPACING) -> Floats:
    """Returns points (k, 2) of a polyline, equally spaced by about `spacing` metres, with both ends."""
    length = lengths(points)[-1]
    return along(points, np.linspace(0.0, length, max(8, ceil(length / spacing) + 1)))


def smoothed(nodes: Floats, tolerance: Floats) -> Floats:
    """Returns nodes (n, 2) of least change of curvature, each within its `tolerance` (n,) of where it was.

    Minimises the sum of weights times squared distances plus the squared third differences (Whittaker 1923; Eilers 2003). Nodes
    beyond their tolerance get more weight, until none is.
    """
    n = len(nodes)
    spacing = np.hypot(*np.diff(nodes, axis=0).T).mean()
    stiffness = _third_differences(n) * (SMOOTHING_LENGTH / spacing) ** 6
    weights = np.ones(n)
    weights[[0, -1]] = 1e4
    origin = nodes.mean(axis=0)
    wanted = nodes - origin
    for _ in range(ROUNDS):
        bands = stiffness.copy()
        bands[-1] += weights
        result = solveh_banded(bands, weights[:, None] * wanted)
        excess = np.hypot(*(result - wanted).T) / tolerance
        if excess.max() <= 1.0:
            break
        weights *= np.maximum(1.0, excess) ** 2 * np.where(excess > 1.0, 1.2, 1.0)
        weights = np.minimum(weights, 1e9)
    return np.asarray(result + origin)


def _third_differences(n: int) -> Floats:
    """Returns the upper bands (4, n) of the matrix of squared third differences."""
    bands = np.zeros((4, n))
    stencil = np.array([-1.0, 3.0, -3.0, 1.0])
    for first in range(4):
        for second in range(first, 4):
            bands[3 - (second - first), second : second + n - 3] += stencil[first] * stencil[second]
    return bands


def table(nodes: Floats, spacing: float = SPACING) -> Floats:
    """Returns the table of the quintic spline through smooth nodes (n, 2).

    Rows are equally spaced by at most `spacing` metres from the first node to the last. Heading is the integral of the linear
    curvature between rows, exactly as `domain.roads.pose_on` reads it.
    """
    parameter = lengths(nodes)
    spline = make_interp_spline(parameter, nodes, k=5)
    velocity = spline.derivative()
    steps = np.diff(parameter)
    points = parameter[:-1, None] + 0.5 * (1.0 + GAUSS_POINTS) * steps[:, None]
    speeds = np.hypot(*np.moveaxis(velocity(points), -1, 0))
    length = np.concatenate([[0.0], np.cumsum(0.5 * steps * (speeds @ GAUSS_WEIGHTS))])
    rows = max(2, ceil(length[-1] / spacing) + 1)
    s = np.linspace(0.0, length[-1], rows)
    at = np.asarray(make_interp_spline(length, parameter, k=5)(s))
    at[[0, -1]] = parameter[[0, -1]]
    position, (dx, dy), (ddx, ddy) = spline(at), velocity(at).T, spline.derivative(2)(at).T
    curvature = (dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3
    turned = np.cumsum(0.5 * (curvature[:-1] + curvature[1:])) * (s[1] - s[0])
    heading = np.arctan2(dy[0], dx[0]) + np.concatenate([[0.0], turned])
    return np.column_stack([s, position, heading, curvature])


def project(line: Floats, points: Floats, near: Floats) -> tuple[Floats, Floats]:
    """Returns s and d (n,) of the points (n, 2) closest on a line, searched from s = `near` (n,).

    NaN for a point without a foot point near there.
    """
    spacing, last = line[1, 0], len(line) - 1
    s = np.asarray(near, np.float64).copy()
    open_ = np.ones(len(s), np.bool_)
    d = np.zeros(len(s))
    for _ in range(PROJECTION_ROUNDS):
        inside = np.clip(s, 0.0, last * spacing)
        row = np.minimum((inside / spacing).astype(np.int64), last - 1)
        _, x0, y0, heading0, curvature0 = line[row].T
        _, x1, y1, heading1, curvature1 = line[row + 1].T
        u = inside - row * spacing
        w = u / spacing
        blend, start, stop = w * w * (3 - 2 * w), w * (1 - w) ** 2 * spacing, w * w * (w - 1) * spacing
        heading = heading0 + u * (curvature0 + 0.5 * (curvature1 - curvature0) * w)
        forward, left, beyond = np.cos(heading), np.sin(heading), s - inside
        dx = points[:, 0] - (x0 + blend * (x1 - x0) + start * np.cos(heading0) + stop * np.cos(heading1) + beyond * forward)
        dy = points[:, 1] - (y0 + blend * (y1 - y0) + start * np.sin(heading0) + stop * np.sin(heading1) + beyond * left)
        d = dy * forward - dx * left
        curvature = np.where(beyond == 0.0, curvature0 + (curvature1 - curvature0) * w, 0.0)
        step = (dx * forward + dy * left) / np.maximum(1.0 - curvature * d, 0.1)
        open_ = np.abs(step) > PROJECTION_TOLERANCE
        if not open_.any():
            break
        s = s + np.where(open_, np.clip(step, -50.0, 50.0), 0.0)
    d[open_] = s[open_] = np.nan
    return s, d

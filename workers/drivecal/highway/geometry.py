"""Compiled geometry of lines and rectangles: points of a reference line, foot points on it, and rectangles that overlap.

`line`, shape (n, 7): a reference line (s, x, y, heading, curvature) with cosine and sine of the heading, as from `with_directions`.
`drivecal.domain.roads` has the same without a compiler.
"""

from math import cos, pi, sin, sqrt

import numpy as np

from drivecal.domain.roads import Floats
from drivecal.highway.compilation import compiled_with

TOLERANCE = 1e-9
"""Step (m) at which Newton's iteration ends."""
SWEEP = 0.1
"""Largest way (m) of one vehicle past another between two places at which `swept` compares them."""


@compiled_with()
def with_directions(line: Floats) -> Floats:
    """Extends a reference line, shape (n, 5), by cosine and sine of the heading, shape (n, 7).

    Compiled, so that both equal the values computed by the functions here to the bit.
    """
    table = np.empty((len(line), 7))
    table[:, :5] = line
    for row in range(len(line)):
        table[row, 5], table[row, 6] = cos(line[row, 3]), sin(line[row, 3])
    return table


@compiled_with()
def point(line: Floats, s: float) -> tuple[float, float, float, float, float]:
    """Returns x, y, heading, curvature and change of curvature (1/m²) of the line at s; straight beyond its ends."""
    spacing = line[1, 0]
    last = len(line) - 1
    if s < 0.0 or s > last * spacing:
        row = 0 if s < 0.0 else last
        ahead = s - row * spacing
        return line[row, 1] + ahead * line[row, 5], line[row, 2] + ahead * line[row, 6], line[row, 3], 0.0, 0.0
    row = min(int(s / spacing), last - 1)
    u = s - line[row, 0]
    bend = (line[row + 1, 4] - line[row, 4]) / spacing
    w = u / spacing
    from_start, from_end = w * (1.0 - w) * (1.0 - w) * spacing, w * w * (w - 1.0) * spacing
    blend = w * w * (3.0 - 2.0 * w)
    x = line[row, 1] + blend * (line[row + 1, 1] - line[row, 1])
    x += from_start * line[row, 5] + from_end * line[row + 1, 5]
    y = line[row, 2] + blend * (line[row + 1, 2] - line[row, 2])
    y += from_start * line[row, 6] + from_end * line[row + 1, 6]
    return x, y, line[row, 3] + u * (line[row, 4] + 0.5 * bend * u), line[row, 4] + bend * u, bend


@compiled_with()
def foot(line: Floats, x: float, y: float, near: float) -> tuple[float, float, float, float, float, float, float]:
    """Returns s, d, and the line's heading, its cosine and sine, curvature and change of curvature (1/m²) at the foot point of (x, y).

    Newton's iteration from s = `near`.
    """
    s = near
    d = heading = curvature = bend = across = 0.0
    along = 1.0
    for _ in range(30):
        foot_x, foot_y, heading, curvature, bend = point(line, s)
        along, across = cos(heading), sin(heading)
        dx, dy = x - foot_x, y - foot_y
        d = dy * along - dx * across
        step = (dx * along + dy * across) / max(1.0 - curvature * d, 0.1)
        if abs(step) < TOLERANCE:
            break
        s += step
    return s, d, heading, along, across, curvature, bend


@compiled_with()
def frenet_motion(
    line: Floats, pose: Floats, near: float
) -> tuple[float, float, float, float, float, float, float, float]:  # fmt: skip
    """Returns s, s', s'', d, d', d'' of a vehicle, its heading relative to the line (rad), and metres of its way per metre of s.

    From r = r0(s) + d n with Frenet's formulas (Werling et al. 2010): v_t = s' (1 - κd), v_n = d',
    a_t = s'' (1 - κd) - s' (κ' s' d + 2 κ d'), a_n = d'' + κ s'² (1 - κd), κ' by arc length.

    Args:
        line: reference line.
        pose: as from `ports.VehicleModel`.
        near: s from which the foot point is searched.
    """
    s, d, heading, _, _, curvature, bend = foot(line, pose[0], pose[1], near)
    yaw = pose[2] - heading
    cosine, sine = cos(yaw + pose[4]), sin(yaw + pose[4])
    stretch = 1.0 - curvature * d
    s_dot, d_dot = pose[3] * cosine / stretch, pose[3] * sine
    tangential = pose[6] * cosine - pose[7] * sine
    normal = pose[6] * sine + pose[7] * cosine
    s_dot_dot = (tangential + s_dot * (bend * s_dot * d + 2.0 * curvature * d_dot)) / stretch
    return s, s_dot, s_dot_dot, d, d_dot, normal - curvature * s_dot * s_dot * stretch, yaw, stretch


@compiled_with()
def hit(outlines: Floats, pose: Floats, size: Floats) -> int:
    """Returns the first of `outlines` that overlaps the ego vehicle's rectangle, -1 if there is none; separating axis theorem.

    `outlines`, shape (k, 5 or more): x, y, heading, half length, half width. `pose` begins with x, y, heading, `size` with half length and
    half width.
    """
    c, s = cos(pose[2]), sin(pose[2])
    for i in range(len(outlines)):
        dx, dy = outlines[i, 0] - pose[0], outlines[i, 1] - pose[1]
        reach = size[0] + size[1] + outlines[i, 3] + outlines[i, 4]
        if dx * dx + dy * dy > reach * reach:
            continue
        other_c, other_s = cos(outlines[i, 2]), sin(outlines[i, 2])
        along, across = abs(c * other_c + s * other_s), abs(c * other_s - s * other_c)
        length, width = outlines[i, 3], outlines[i, 4]
        if (
            abs(dx * c + dy * s) <= size[0] + length * along + width * across
            and abs(dy * c - dx * s) <= size[1] + length * across + width * along
            and abs(dx * other_c + dy * other_s) <= length + size[0] * along + size[1] * across
            and abs(dy * other_c - dx * other_s) <= width + size[0] * across + size[1] * along
        ):
            return i
    return -1


@compiled_with()
def _turned(begin: float, end: float, share: float) -> float:
    """Returns the direction at a share of the shorter turn from one to another (rad)."""
    turn = end - begin
    turn -= 2.0 * pi * np.floor((turn + pi) / (2.0 * pi))
    return begin + share * turn


@compiled_with()
def swept(before: Floats, outlines: Floats, start: Floats, pose: Floats, size: Floats) -> int:
    """Returns the first outline that overlaps the ego vehicle's rectangle between two times, -1 if there is none.

    All move and turn evenly from `before` to `outlines` and from `start` to `pose`, arrays as in `hit`, whose ends `hit` checks itself.
    An outline without a place at one of the times (x = NaN) overlaps nothing.
    """
    outline, place = np.empty((1, 5)), np.empty(3)
    for i in range(len(outlines)):
        x, y = before[i, 0] - start[0], before[i, 1] - start[1]
        step_x, step_y = outlines[i, 0] - pose[0] - x, outlines[i, 1] - pose[1] - y
        square = step_x * step_x + step_y * step_y
        if not square > 0.0:
            continue
        nearest = min(max(-(x * step_x + y * step_y) / square, 0.0), 1.0)
        reach = size[0] + size[1] + outlines[i, 3] + outlines[i, 4]
        if (x + nearest * step_x) ** 2 + (y + nearest * step_y) ** 2 > reach * reach:
            continue
        outline[0, 3], outline[0, 4] = outlines[i, 3], outlines[i, 4]
        parts = int(sqrt(square) / SWEEP) + 1
        for part in range(1, parts):
            share = part / parts
            for column in range(2):
                outline[0, column] = before[i, column] + share * (outlines[i, column] - before[i, column])
                place[column] = start[column] + share * (pose[column] - start[column])
            outline[0, 2] = _turned(before[i, 2], outlines[i, 2], share)
            place[2] = _turned(start[2], pose[2], share)
            if hit(outline, place, size) >= 0:
                return i
    return -1

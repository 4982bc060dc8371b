"""Compiled geometry of a run: positions on the road, road departure and collisions of the ego vehicle.

Functions that call each other share this module, because numba's cache does not notice edits in imported modules.
"""

from math import cos, pi, sin

import numpy as np
from numba import njit

from drivecal.domain.roads import Floats

TOLERANCE = 1e-9
"""Step (m) at which Newton's iteration ends."""


@njit(cache=True)
def with_directions(line: Floats) -> Floats:
    """Extends the table of `drivecal.domain.roads.reference_line`, shape (n, 5), by cosine and sine of the heading, shape (n, 7).

    Compiled, so that both equal the values computed by the functions here to the bit.
    """
    table = np.empty((len(line), 7))
    table[:, :5] = line
    for row in range(len(line)):
        table[row, 5], table[row, 6] = cos(line[row, 3]), sin(line[row, 3])
    return table


@njit(cache=True)
def foot(line: Floats, x: float, y: float, near: float) -> tuple[float, float, float, float, float, float, float]:
    """Returns s, d, and the line's heading, its cosine and sine, curvature and change of curvature (1/m²) at the foot point of (x, y).

    Compiled version of `drivecal.domain.roads.project`, with equal interpolation and Newton iteration from s = `near`. `line`: as from
    `with_directions`.
    """
    spacing = line[1, 0]
    last = len(line) - 1
    s = near
    d = heading = curvature = bend = across = 0.0
    along = 1.0
    for _ in range(30):
        if s < 0.0 or s > last * spacing:
            row = 0 if s < 0.0 else last
            heading, curvature, bend = line[row, 3], 0.0, 0.0
            ahead = s - row * spacing
            along, across = line[row, 5], line[row, 6]
            foot_x, foot_y = line[row, 1] + ahead * along, line[row, 2] + ahead * across
        else:
            row = min(int(s / spacing), last - 1)
            u = s - line[row, 0]
            bend = (line[row + 1, 4] - line[row, 4]) / spacing
            w = u / spacing
            from_start, from_end = w * (1.0 - w) * (1.0 - w) * spacing, w * w * (w - 1.0) * spacing
            blend = w * w * (3.0 - 2.0 * w)
            foot_x = line[row, 1] + blend * (line[row + 1, 1] - line[row, 1])
            foot_x += from_start * line[row, 5] + from_end * line[row + 1, 5]
            foot_y = line[row, 2] + blend * (line[row + 1, 2] - line[row, 2])
            foot_y += from_start * line[row, 6] + from_end * line[row + 1, 6]
            heading = line[row, 3] + u * (line[row, 4] + 0.5 * bend * u)
            curvature = line[row, 4] + bend * u
            along, across = cos(heading), sin(heading)
        dx, dy = x - foot_x, y - foot_y
        d = dy * along - dx * across
        step = (dx * along + dy * across) / max(1.0 - curvature * d, 0.1)
        if abs(step) < TOLERANCE:
            break
        s += step
    return s, d, heading, along, across, curvature, bend


@njit(cache=True)
def locate(line: Floats, raw: Floats, neighbours: Floats, outlines: Floats, step: float) -> None:
    """Updates Frenet states and outlines in place from SUMO's raw values.

    `line`: as from `with_directions`. `raw`: (x, y) of each vehicle's front, its speed and its offset d, shape (n, 4). SUMO's lanes are
    chords of the curves, so that d computed from x and y would be rough. `neighbours`: (s, d, s', d', length, width) of each centre, shape
    (n, 6), with the values of `step` seconds ago; a `step` of 0 means that these do not exist. `outlines`: (x, y, heading, half length,
    half width), shape (n, 5).
    """
    for i in range(len(raw)):
        half_length = 0.5 * neighbours[i, 4]
        near = neighbours[i, 0] + half_length + neighbours[i, 2] * step
        s, chord_d, heading, along, across, curvature, _ = foot(line, raw[i, 0], raw[i, 1], near)
        d = raw[i, 3]
        stretch = 1.0 - curvature * d
        neighbours[i, 3] = (d - neighbours[i, 1]) / step if step > 0.0 else 0.0
        neighbours[i, 0] = s - half_length / stretch
        neighbours[i, 1] = d
        neighbours[i, 2] = raw[i, 2] / stretch
        front_x = raw[i, 0] - (d - chord_d) * across
        front_y = raw[i, 1] + (d - chord_d) * along
        heading -= half_length * curvature / stretch
        outlines[i, 0] = front_x - half_length * cos(heading)
        outlines[i, 1] = front_y - half_length * sin(heading)
        outlines[i, 2] = heading
        outlines[i, 3] = half_length
        outlines[i, 4] = 0.5 * neighbours[i, 5]


@njit(cache=True)
def place(line: Floats, pose: Floats, near: float, outline: Floats, motion: Floats, front: Floats) -> bool:
    """Writes the ego vehicle's Frenet motion and SUMO's position of it; returns whether it is on the road.

    `motion`: (s, s', s'', d, d', d''), shape (6,). `front`: SUMO's position, i.e. x and y of the front and the angle in degrees clockwise
    from north, shape (3,). `line`: as from `with_directions`. `pose`: as from `ports.VehicleModel`, accelerations in the vehicle's own
    axes. `outline`: (half length, half width, right edge, left edge), m; the edges are offsets d of the carriageway's borders. Formulas as
    in `drivecal.domain.roads.to_frenet`.
    """
    s, d, heading, _, _, curvature, bend = foot(line, pose[0], pose[1], near)
    yaw = pose[2] - heading
    course = yaw + pose[4]
    stretch = 1.0 - curvature * d
    s_dot = pose[3] * cos(course) / stretch
    d_dot = pose[3] * sin(course)
    tangential = pose[6] * cos(yaw) - pose[7] * sin(yaw)
    normal = pose[6] * sin(yaw) + pose[7] * cos(yaw)
    motion[0] = s
    motion[1] = s_dot
    motion[2] = (tangential + s_dot * (bend * s_dot * d + 2.0 * curvature * d_dot)) / stretch
    motion[3] = d
    motion[4] = d_dot
    motion[5] = normal - curvature * s_dot * s_dot * stretch
    front[0] = pose[0] + outline[0] * cos(pose[2])
    front[1] = pose[1] + outline[0] * sin(pose[2])
    front[2] = 90.0 - pose[2] * (180.0 / pi)
    reach = outline[0] * abs(sin(yaw)) + outline[1] * abs(cos(yaw))
    return bool(d - reach >= outline[2] and d + reach <= outline[3])


@njit(cache=True)
def hits(outlines: Floats, pose: Floats, outline: Floats) -> bool:
    """Returns whether the ego vehicle's rectangle overlaps one of `outlines`, shape (n, 5), see `locate`; separating axis theorem."""
    c, s = cos(pose[2]), sin(pose[2])
    for i in range(len(outlines)):
        dx, dy = outlines[i, 0] - pose[0], outlines[i, 1] - pose[1]
        reach = outline[0] + outline[1] + outlines[i, 3] + outlines[i, 4]
        if dx * dx + dy * dy > reach * reach:
            continue
        other_c, other_s = cos(outlines[i, 2]), sin(outlines[i, 2])
        along, across = abs(c * other_c + s * other_s), abs(c * other_s - s * other_c)
        length, width = outlines[i, 3], outlines[i, 4]
        if (
            abs(dx * c + dy * s) <= outline[0] + length * along + width * across
            and abs(dy * c - dx * s) <= outline[1] + length * across + width * along
            and abs(dx * other_c + dy * other_s) <= length + outline[0] * along + outline[1] * across
            and abs(dy * other_c - dx * other_s) <= width + outline[0] * across + outline[1] * along
        ):
            return True
    return False


@njit(cache=True)
def settle(line: Floats, raw: Floats, neighbours: Floats, outlines: Floats, step: float, pose: Floats, outline: Floats) -> bool:
    """Combines `locate` and `hits` in one call."""
    locate(line, raw, neighbours, outlines, step)
    return hits(outlines, pose, outline)

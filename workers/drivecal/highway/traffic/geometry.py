"""Compiled geometry of a run: where vehicles are on the road, road departure and collisions of the ego vehicle.

Arrays:

`line`, shape (n, 7): the road's reference line, as from `with_directions`. `along`, shape (n, m): positions along each of m lanes at its
rows, as SUMO counts. `frame`, shape (7,): half length and half width of the ego vehicle, d of the carriageway's right and left border,
lane width, last lane, step. `ego`, shape (4,): lane of the ego vehicle's centre, position of its front along that lane, speed to take
SUMO's vehicle there in a step, and 1 if the lane is another than before. `cells`, shape (4, k): SUMO's speed of each other vehicle, its d,
lane, and position of its front along the lane. `neighbours`, shape (k, 6): s, d, s', d', length and width of their centres. `outlines`,
shape (k, 5): x, y, heading, half length, half width.
"""

from math import cos, floor, sin

from drivecal.domain.roads import Floats
from drivecal.highway import geometry
from drivecal.highway.compilation import compiled_with
from drivecal.highway.geometry import frenet_motion, hit, point

compiled = compiled_with(geometry)

SPEED, OFFSET, LANE, PLACE = 0, 1, 2, 3
"""Rows of `cells`."""
STEP = 6
"""Index of the step in `frame`."""


@compiled
def along_at(line: Floats, along: Floats, lane: int, s: float) -> float:
    """Returns the position along a lane at s."""
    row = min(max(int(s / line[1, 0]), 0), len(line) - 2)
    share = (s - line[row, 0]) / line[1, 0]
    value: float = along[row, lane] + share * (along[row + 1, lane] - along[row, lane])
    return value


@compiled
def s_at(line: Floats, along: Floats, lane: int, place: float, near: float) -> float:
    """Returns s at a position along a lane, searched from s = `near`. The inverse of `along_at`."""
    last = len(line) - 2
    row = min(max(int(near / line[1, 0]), 0), last)
    while row < last and along[row + 1, lane] <= place:
        row += 1
    while row > 0 and along[row, lane] > place:
        row -= 1
    way = along[row + 1, lane] - along[row, lane]
    s: float = line[row, 0] + (line[1, 0] * (place - along[row, lane]) / way if way > 0.0 else 0.0)
    return s


@compiled
def locate(line: Floats, along: Floats, cells: Floats, neighbours: Floats, outlines: Floats, step: float) -> None:
    """Moves the other vehicles to the end of a step of `step` seconds at the speeds in `cells`.

    A step of 0 means that there was none, and they do not move sideways.
    """
    for i in range(cells.shape[1]):
        cells[PLACE, i] += cells[SPEED, i] * step
        half_length = 0.5 * neighbours[i, 4]
        near = neighbours[i, 0] + half_length + neighbours[i, 2] * step
        front = s_at(line, along, int(cells[LANE, i]), cells[PLACE, i], near)
        d = cells[OFFSET, i]
        _, _, _, curvature, _ = point(line, front)
        stretch = 1.0 - curvature * d
        s = front - half_length / stretch
        x, y, heading, _, _ = point(line, s)
        neighbours[i, 3] = (d - neighbours[i, 1]) / step if step > 0.0 else 0.0
        neighbours[i, 0] = s
        neighbours[i, 1] = d
        neighbours[i, 2] = cells[SPEED, i] / stretch
        outlines[i, 0] = x - d * sin(heading)
        outlines[i, 1] = y + d * cos(heading)
        outlines[i, 2] = heading
        outlines[i, 3] = half_length
        outlines[i, 4] = 0.5 * neighbours[i, 5]


@compiled
def place(line: Floats, along: Floats, frame: Floats, pose: Floats, near: float, motion: Floats, ego: Floats) -> bool:
    """Writes the ego vehicle's Frenet motion and SUMO's place of it; returns whether it is on the road.

    `motion`: (s, s', s'', d, d', d''), shape (6,). `pose`, `near`: as in `frenet_motion`.
    """
    s, s_dot, s_dot_dot, d, d_dot, d_dot_dot, yaw, stretch = frenet_motion(line, pose, near)
    motion[0], motion[1], motion[2] = s, s_dot, s_dot_dot
    motion[3], motion[4], motion[5] = d, d_dot, d_dot_dot
    lane = min(max(floor(d / frame[4] + 0.5), 0.0), frame[5])
    front = along_at(line, along, int(lane), s + frame[0] / stretch)
    ego[2], ego[3] = pose[3], 1.0
    if lane == ego[0]:
        front = max(front, ego[1])
        ego[2], ego[3] = (front - ego[1]) / frame[STEP], 0.0
    ego[0], ego[1] = lane, front
    reach = frame[0] * abs(sin(yaw)) + frame[1] * abs(cos(yaw))
    return bool(d - reach >= frame[2] and d + reach <= frame[3])


@compiled
def settle(
    line: Floats, along: Floats, cells: Floats, neighbours: Floats, outlines: Floats, step: float, pose: Floats, size: Floats
) -> bool:
    """Combines `locate` and `hit` in one call; returns whether the ego vehicle, with `size` as in `hit`, has hit another."""
    locate(line, along, cells, neighbours, outlines, step)
    return hit(outlines, pose, size) >= 0

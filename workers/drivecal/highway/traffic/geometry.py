"""Compiled geometry of a run: positions on the road, road departure and collisions of the ego vehicle."""

from math import cos, pi, sin

from drivecal.domain.roads import Floats
from drivecal.highway import geometry
from drivecal.highway.compilation import compiled_with
from drivecal.highway.geometry import foot, hit

compiled = compiled_with(geometry)


@compiled
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


@compiled
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


@compiled
def settle(line: Floats, raw: Floats, neighbours: Floats, outlines: Floats, step: float, pose: Floats, outline: Floats) -> bool:
    """Combines `locate` and `hit` in one call; returns whether the ego vehicle has hit another."""
    locate(line, raw, neighbours, outlines, step)
    return hit(outlines, pose, outline) >= 0

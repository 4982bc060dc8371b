"""Compiled geometry of a run: where vehicles are on the road, what the ego vehicle observes, the path it keeps, collisions.

Arrays:

`line`, shape (n, 7): the road's reference line, as from `with_directions`. `lanes`, shape (n, m, 5): centre, width, limit and slope of
the centre of each of m tracks at these rows, NaN if the track does not exist, and the position along its lanes as SUMO counts. `pose`: as
from `highway.vehicle`. `motion`, shape (MOTION,): the ego vehicle's place, see `place`. `neighbours`, shape (k, 6): s, d, s', d', length
and width of other vehicles, s and d of their centres, NaN on other levels. `outlines`, shape (k, OUTLINED): their x, y, heading, half
length, half width, speed and acceleration, both along their own way and negative against the route, and what SUMO says of them, see
`locate`.
"""

from math import atan, cos, inf, isnan, nan, pi, sin

import numpy as np

from drivecal.bundles import highway_catalogue
from drivecal.domain.roads import Floats
from drivecal.highway import geometry as shared
from drivecal.highway.compilation import compiled_with
from drivecal.highway.geometry import foot, frenet_motion, hit, point, swept

NAMES = tuple(highway_catalogue.SIGNALS)
"""Signals that a controller observes, in the order of `observe`."""
SPEED, LIMIT_AHEAD, GAP, LEADER_SPEED = (NAMES.index(name) for name in ("speed", "limit_ahead", "gap", "leader_speed"))

TIME_HEADWAY, STANDSTILL_GAP, ACCELERATION, DECELERATION = 1.5, 2.0, 1.5, 2.0
"""The built-in speed keeper: the intelligent driver model (Treiber et al. 2000) with these values and the limit ahead as desired speed.
The model would brake with 9 m/s² for a sign of 80 km/h at 130; this keeper never brakes harder for a limit than `DECELERATION`."""


def keeper_acceleration(signals: "memoryview[float] | list[float]") -> float:
    """Returns the acceleration (m/s²) of the built-in speed keeper, for controllers that do not output one."""
    speed, limit, gap = signals[SPEED], max(signals[LIMIT_AHEAD], 1.0), max(signals[GAP], 0.1)
    free = max(1.0 - (speed / limit) ** 4, -DECELERATION / ACCELERATION)
    wanted = STANDSTILL_GAP + max(
        0.0, speed * TIME_HEADWAY + speed * (speed - signals[LEADER_SPEED]) / (2.0 * (ACCELERATION * DECELERATION) ** 0.5)
    )
    return ACCELERATION * (free - (wanted / gap) ** 2 if gap < FAR else free)


compiled = compiled_with(shared)

FARTHEST = 25.0
"""Distance (m) from the line beyond which the foot point is searched again: the vehicle drives elsewhere, or the iteration went astray."""
OVERLAP = 0.3
"""A vehicle is in each lane into which it reaches by more than this (m)."""
GORE = 4.0
"""Largest distance (m) between two lanes of one road, between which another one may open. Ramps farther apart are roads of their own."""
CROSSING = 0.5
"""Cosine of the angle to the road above which a vehicle drives along it; another one is as fast along the road as its part of the speed."""
FAR = 1000.0
"""Gap without a vehicle; `highway_catalogue.FAR`."""
OWN, BESIDE = 20, 7
"""Number of signals of the vehicle itself, and of each adjacent lane; the own lane has one less. Order: see `observe`."""
OF_LEADER = OWN + 3 * BESIDE - 1
"""First of the two signals that follow from the leader's in the own lane."""
SIGNALS = OF_LEADER + 2
RECORDED = 17
"""Columns of a record, see `record`, before the six of `motion`'s Frenet motion."""
S, D, TRACK, OFFSET, HEADING_ERROR, STRETCH, LIMIT, WIDTH, ALONG = range(9)
FRENET, FRONT, OWN_SPEED, STEERING, SIZE, EDGE, STEP, KEEPS_LANES, ROW, MOTION = 9, 15, 18, 19, 20, 22, 23, 24, 25, 26
"""Further entries of `motion`, and their number: see `place` and `settle`."""
SAID = 7
"""First of the columns of `outlines` that hold what SUMO says: see `locate`."""
OUTLINED = SAID + 4


@compiled
def nearest(line: Floats, x: float, y: float) -> float:
    """Returns s of the row that is closest to a point."""
    best, least = 0, inf
    for row in range(len(line)):
        dx, dy = x - line[row, 1], y - line[row, 2]
        square = dx * dx + dy * dy
        if square < least:
            best, least = row, square
    return line[best, 0]


@compiled
def searched(line: Floats, x: float, y: float, near: float) -> tuple[float, float, float, float]:
    """Returns s, d, heading and curvature at the foot point, searched along the whole line if that is not near s = `near`."""
    s, d, heading, _, _, curvature, _ = foot(line, x, y, near)
    if not (abs(d) <= FARTHEST and -FARTHEST <= s <= line[-1, 0] + FARTHEST):
        s, d, heading, _, _, curvature, _ = foot(line, x, y, nearest(line, x, y))
    return s, d, heading, curvature


@compiled
def _row(line: Floats, s: float) -> tuple[int, float]:
    """Returns the row at or before s and the share of the way to the next one."""
    position = s / line[1, 0]
    row = min(max(int(position), 0), len(line) - 2)
    return row, min(max(position - row, 0.0), 1.0)


@compiled
def _lane(lanes: Floats, row: int, share: float, track: int, column: int) -> float:
    """Returns a column of a track between rows; the row that exists if the track begins or ends there, else NaN."""
    here, there = lanes[row, track, column], lanes[row + 1, track, column]
    if isnan(there):
        return here
    if isnan(here):
        return there
    value: float = here + share * (there - here)
    return value


@compiled
def track_at(line: Floats, lanes: Floats, s: float, d: float) -> int:
    """Returns the track that holds d, of several the one with the closest centre; else the one whose side is closest; -1 without any."""
    row, share = _row(line, s)
    best, least = -1, inf
    for track in range(lanes.shape[1]):
        distance, half = abs(d - _lane(lanes, row, share, track, 0)), 0.5 * _lane(lanes, row, 0.0, track, 1)
        if distance > half:
            distance += FARTHEST - half
        if distance < least:
            best, least = track, distance
    return best


@compiled
def _borders(lanes: Floats, row: int, share: float, track: int) -> tuple[float, float]:
    """Returns d of the right and the left border of the road of a track: of all lanes that follow each other without a gap."""
    centre, half = _lane(lanes, row, share, track, 0), 0.5 * _lane(lanes, row, 0.0, track, 1)
    right, left = centre - half, centre + half
    grows = True
    while grows:
        grows = False
        for other in range(lanes.shape[1]):
            centre, half = _lane(lanes, row, share, other, 0), 0.5 * _lane(lanes, row, 0.0, other, 1)
            if not (centre - half <= left + GORE and centre + half >= right - GORE):
                continue
            if centre - half < right:
                right, grows = centre - half, True
            if centre + half > left:
                left, grows = centre + half, True
    return right, left


@compiled
def place(line: Floats, lanes: Floats, pose: Floats, near: float, motion: Floats) -> bool:
    """Writes the ego vehicle's place on the road and SUMO's position of it; returns whether it is on the road.

    `motion`: s, d, track, offset from its centre, heading error, metres of the lane per metre of s, limit and width of the lane, and the
    position of the vehicle's front along the track's lanes as SUMO counts. From FRENET: s, s', s'', d, d', d''. From FRONT: SUMO's
    position, i.e. x and y of the front and the angle in degrees clockwise from north. OWN_SPEED: speed. Given are STEERING, the steering
    angle, and from SIZE half length, half width, and the distance beyond the road's lanes at which a vehicle is off it.
    """
    s, s_dot, s_dot_dot, d, d_dot, d_dot_dot, yaw, stretch = frenet_motion(line, pose, near)
    motion[9], motion[10], motion[11], motion[12], motion[13], motion[14] = s, s_dot, s_dot_dot, d, d_dot, d_dot_dot
    row, share = _row(line, s)
    track = track_at(line, lanes, s, d)
    motion[S], motion[D], motion[TRACK] = s, d, track
    half, motion[OWN_SPEED] = motion[SIZE], pose[3]
    motion[FRONT] = pose[0] + half * cos(pose[2])
    motion[FRONT + 1] = pose[1] + half * sin(pose[2])
    motion[FRONT + 2] = 90.0 - pose[2] * (180.0 / pi)
    if track < 0:
        return False
    slope = _lane(lanes, row, share, track, 3)
    if slope != 0.0:
        slope = atan(slope / stretch)
    yaw -= 2.0 * pi * np.floor((yaw + pi) / (2.0 * pi))
    motion[OFFSET] = d - _lane(lanes, row, share, track, 0)
    motion[HEADING_ERROR], motion[STRETCH] = yaw - slope, stretch
    motion[LIMIT], motion[WIDTH] = _lane(lanes, row, 0.0, track, 2), _lane(lanes, row, 0.0, track, 1)
    row_ahead, share_ahead = _row(line, s + half / stretch)
    motion[ALONG] = _lane(lanes, row_ahead, share_ahead, track, 4)
    right, left = _borders(lanes, row, share, track)
    reach = half * abs(sin(yaw)) + motion[SIZE + 1] * abs(cos(yaw))
    return bool(0.0 <= s <= line[-1, 0] and d - reach >= right - motion[EDGE] and d + reach <= left + motion[EDGE])


@compiled
def _s_at(line: Floats, lanes: Floats, track: int, place: float, near: float) -> float:
    """Returns s at a position along a track as SUMO counts, searched from s = `near`."""
    last = len(line) - 2
    row = min(max(int(near / line[1, 0]), 0), last)
    while row < last and lanes[row + 1, track, 4] <= place:
        row += 1
    while row > 0 and lanes[row, track, 4] > place:
        row -= 1
    way = lanes[row + 1, track, 4] - lanes[row, track, 4]
    s: float = line[row, 0] + (line[1, 0] * (place - lanes[row, track, 4]) / way if way > 0.0 else 0.0)
    return s


def moved_on(outlines: Floats, seconds: float) -> Floats:
    """Returns the outlines at a later time, straight on at their speeds."""
    moved, ways = outlines.copy(), seconds * np.abs(outlines[:, 5])
    moved[:, 0] += ways * np.cos(outlines[:, 2])
    moved[:, 1] += ways * np.sin(outlines[:, 2])
    return moved


@compiled
def locate(
    line: Floats, lanes: Floats, neighbours: Floats, outlines: Floats, step: float,
    keeps_lanes: bool,  # noqa: FBT001  # kernels take arguments by position
) -> None:  # fmt: skip
    """Updates `neighbours` and `outlines` in place from what SUMO says.

    The columns of `outlines` from SAID hold, if the vehicles keep their lanes, each vehicle's position along its track a step ago, which
    is moved on by its speed, its offset from the track's centre now, its speed, and the track. Else x and y of its front, its speed, and
    its heading. A vehicle on another level has x = NaN, and no place. A vehicle that keeps to the route has the heading NaN: the line's,
    which has no corners.

    `step`: seconds since the last update; 0 means that there was none, so that foot points are searched and rates are 0.
    """
    for i in range(len(neighbours)):
        half, speed, rate = 0.5 * neighbours[i, 4], outlines[i, SAID + 2], nan
        change = (speed - abs(outlines[i, 5])) / step if step > 0.0 else 0.0
        near = neighbours[i, 0] + half + neighbours[i, 2] * step
        if keeps_lanes:
            track = int(outlines[i, SAID + 3])
            outlines[i, SAID] += speed * step
            front = _s_at(line, lanes, track, outlines[i, SAID], near)
            row, share = _row(line, front)
            d = _lane(lanes, row, share, track, 0) + outlines[i, SAID + 1]
            stretch = 1.0 - point(line, front)[3] * d
            s = front - half / stretch
            x, y, heading, _, _ = point(line, s)
            outlines[i, 0], outlines[i, 1] = x - d * sin(heading), y + d * cos(heading)
            slope = _lane(lanes, row, share, track, 3)
            if slope != 0.0:
                heading += atan(slope / stretch)
        else:
            x, y, heading = outlines[i, SAID], outlines[i, SAID + 1], outlines[i, SAID + 3]
            if isnan(x):
                neighbours[i, 0] = neighbours[i, 1] = outlines[i, 0] = outlines[i, 1] = nan
                neighbours[i, 2], neighbours[i, 3] = speed, 0.0
                outlines[i, 5], outlines[i, 6] = speed, change
                continue
            strays = not isnan(heading)
            if strays:
                near -= half
                x -= half * cos(heading)
                y -= half * sin(heading)
            if step > 0.0 and not isnan(neighbours[i, 0]):
                s, d, course, curvature = searched(line, x, y, near)
            else:
                s, d, course, _, _, curvature, _ = foot(line, x, y, nearest(line, x, y))
            stretch = max(1.0 - curvature * d, 0.1)
            if strays:
                turned = cos(heading - course)
                if abs(turned) < CROSSING:
                    rate = speed * turned
                if turned < 0.0:
                    speed, change = -speed, -change
            else:
                heading = course - half * curvature / stretch
                x -= half * cos(heading)
                y -= half * sin(heading)
                s -= half / stretch
            outlines[i, 0], outlines[i, 1] = x, y
        neighbours[i, 3] = (d - neighbours[i, 1]) / step if step > 0.0 and not isnan(neighbours[i, 1]) else 0.0
        neighbours[i, 0], neighbours[i, 1], neighbours[i, 2] = s, d, (speed if isnan(rate) else rate) / stretch
        outlines[i, 2], outlines[i, 3], outlines[i, 4] = heading, half, 0.5 * neighbours[i, 5]
        outlines[i, 5], outlines[i, 6] = speed, change


@compiled
def _seen(
    line: Floats, lanes: Floats, neighbours: Floats, outlines: Floats, track: int, motion: Floats, speed: float, lead: float,
    seen: Floats,
) -> None:  # fmt: skip
    """Writes gap, speed and acceleration of the leader and of the follower in a track to `seen`, shape (6,).

    `lead`: seconds since the other vehicles were read, for which they are moved on. A vehicle against the route is no follower.
    """
    seen[0], seen[1], seen[2] = FAR, speed, 0.0
    seen[3], seen[4], seen[5] = FAR, speed, 0.0
    if track < 0:
        return
    for i in range(len(neighbours)):
        s = neighbours[i, 0] + neighbours[i, 2] * lead
        if not 0.0 <= s <= line[-1, 0]:  # NaN, too
            continue
        ahead = (s - motion[S]) * motion[STRETCH]
        gap = abs(ahead) - motion[SIZE] - 0.5 * neighbours[i, 4]
        first = 0 if ahead >= 0.0 else 3
        if gap >= seen[first] or (ahead < 0.0 and outlines[i, 5] < 0.0):
            continue
        row, share = _row(line, s)
        reach = 0.5 * (_lane(lanes, row, 0.0, track, 1) + neighbours[i, 5]) - OVERLAP
        if abs(neighbours[i, 1] - _lane(lanes, row, share, track, 0)) < reach:
            seen[first], seen[first + 1], seen[first + 2] = gap, outlines[i, 5], outlines[i, 6]
            if abs(neighbours[i, 2]) < CROSSING * abs(outlines[i, 5]):
                seen[first + 1], seen[first + 2] = neighbours[i, 2] * motion[STRETCH], 0.0


@compiled
def _curvature(line: Floats, lanes: Floats, track: int, s: float) -> float:
    """Returns the curvature of a track's centre."""
    row, share = _row(line, s)
    curvature = line[row, 4] + share * (line[row + 1, 4] - line[row, 4])
    centre = _lane(lanes, row, share, track, 0)
    bend = (lanes[row + 1, track, 3] - lanes[row, track, 3]) / line[1, 0]
    if isnan(centre):
        return curvature
    return curvature / (1.0 - curvature * centre) + (0.0 if isnan(bend) else bend)


@compiled
def observe(
    line: Floats, lanes: Floats, ends: Floats, neighbours: Floats, outlines: Floats, motion: Floats, pose: Floats, time: float,
    lead: float, signals: Floats,
) -> None:  # fmt: skip
    """Writes the ego vehicle's observation. The order of `signals`, shape (SIGNALS,), is that of `NAMES`.

    `ends`: s at which each track ends, shape (m,); `lead`: as in `_seen`.
    """
    s, speed, track = motion[S], pose[3], int(motion[TRACK])
    signals[0], signals[1], signals[2], signals[3] = time, speed, pose[6], pose[7]
    signals[4], signals[5], signals[6] = pose[5], pose[4], motion[STEERING]
    signals[7], signals[8], signals[9], signals[10] = s, motion[TRACK], motion[OFFSET], motion[HEADING_ERROR]
    signals[11] = motion[WIDTH]
    signals[12], signals[13] = min((ends[track] - s) * motion[STRETCH], FAR), line[-1, 0] - s
    signals[14] = signals[15] = motion[LIMIT]
    last = s + max(3.0 * speed, 50.0)
    row = _row(line, s)[0]
    while row < len(line) and line[row, 0] <= last:
        if lanes[row, track, 2] < signals[15]:
            signals[15] = lanes[row, track, 2]
        row += 4
    for i, seconds in enumerate((0.0, 1.0, 2.0, 4.0)):
        signals[16 + i] = _curvature(line, lanes, track, min(s + seconds * speed, line[-1, 0]))
    row, share = _row(line, s)
    own, half_width = _lane(lanes, row, share, track, 0), 0.5 * motion[WIDTH]
    left, right, above, below = -1, -1, inf, -inf
    for other in range(lanes.shape[1]):
        centre, reach = _lane(lanes, row, share, other, 0), half_width + 0.5 * _lane(lanes, row, 0.0, other, 1) + GORE
        if own + 0.5 < centre < min(above, own + reach):
            left, above = other, centre
        if own - 0.5 > centre > max(below, own - reach):
            right, below = other, centre
    _seen(line, lanes, neighbours, outlines, track, motion, speed, lead, signals[OWN : OWN + 6])
    first = OWN + 6
    for side in (left, right):
        signals[first] = 0.0 if side < 0 else 1.0
        _seen(line, lanes, neighbours, outlines, side, motion, speed, lead, signals[first + 1 : first + BESIDE])
        first += BESIDE
    signals[OF_LEADER] = 1.0 if signals[OWN] < FAR else 0.0
    signals[OF_LEADER + 1] = signals[OWN + 1] - speed


@compiled
def record(
    line: Floats, lanes: Floats, neighbours: Floats, outlines: Floats, motion: Floats, pose: Floats, time: float, lead: float,
    row: Floats,
) -> None:  # fmt: skip
    """Writes a row of the run's record, shape (RECORDED + 6,), in the order of `drivecal.highway.drive.measures.COLUMNS`.

    `lead`: as in `_seen`.
    """
    row[0], row[1], row[2], row[3] = time, pose[0], pose[1], pose[2]
    row[4], row[5], row[6] = motion[S], motion[OFFSET], motion[TRACK]
    row[7], row[8], row[9], row[10], row[11] = pose[3], pose[6], pose[7], motion[STEERING], motion[LIMIT]
    seen = np.empty(6)
    _seen(line, lanes, neighbours, outlines, int(motion[TRACK]), motion, pose[3], lead, seen)
    row[12], row[13], row[14], row[15], row[16] = seen[0], seen[1], seen[3], seen[4], motion[WIDTH]
    for column in range(6):
        row[RECORDED + column] = motion[FRENET + column]


@compiled
def settle(
    line: Floats, lanes: Floats, neighbours: Floats, outlines: Floats, motion: Floats, pose: Floats, rows: Floats
) -> int:  # fmt: skip
    """Combines `locate`, `record`, `hit` and `swept` in one call, the end of a step: returns the outline that was hit, or -1.

    `motion` has the step (s) of the traffic, whether its vehicles keep their lanes, and the last row that was written: the next is.
    """
    before, size, step = outlines.copy(), motion[SIZE : SIZE + 2], motion[STEP]
    motion[ROW] += 1.0
    row = int(motion[ROW])
    locate(line, lanes, neighbours, outlines, step, motion[KEEPS_LANES] > 0.0)
    record(line, lanes, neighbours, outlines, motion, pose, row * step, 0.0, rows[row])
    struck = hit(outlines, pose, size)
    return struck if struck >= 0 else swept(before, outlines, rows[row - 1, 1:4], pose, size)


@compiled
def path_of(line: Floats, lanes: Floats, track: int, s: float, speed: float, path: Floats) -> None:
    """Writes the path along a track's centre at a constant speed, beginning at s, as a trajectory (t, x, y, heading, curvature, speed, 0).

    `path`, shape (n, 7), has its times. Where the track does not exist, the path goes on at the last offset.
    """
    last = _row(line, s)[0]
    while last > 0 and isnan(lanes[last, track, 0]):
        last -= 1
    offset = 0.0 if isnan(lanes[last, track, 0]) else lanes[last, track, 0]
    before = 0.0
    stretch = 1.0
    for i in range(len(path)):
        s += speed * (path[i, 0] - before) / stretch
        before = path[i, 0]
        x, y, heading, curvature, _ = point(line, s)
        row, share = _row(line, s)
        centre, slope = _lane(lanes, row, share, track, 0), _lane(lanes, row, share, track, 3)
        exists = not isnan(centre)
        if not exists:
            centre, slope = offset, 0.0
        offset = centre
        stretch = max(1.0 - curvature * centre, 0.1)
        path[i, 1], path[i, 2] = x - centre * sin(heading), y + centre * cos(heading)
        path[i, 3] = heading + atan(slope / stretch)
        path[i, 4] = _curvature(line, lanes, track, s) if exists else curvature / stretch
        path[i, 5] = speed
        path[i, 6] = 0.0

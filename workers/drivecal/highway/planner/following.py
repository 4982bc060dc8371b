"""Compiled desired speed behind a slower vehicle, for the planner on corridors.

Candidates end within 8 m/s of the desired speed, so that a planner that wants its speed whatever is ahead cannot follow a vehicle that is
slower than that, and brakes only in its last seconds. The tasks of the built-in motorway have no such leader. On corridors a leader is
what a lower limit is there: the desired speed falls ahead of it such that `LATEST_DECELERATION` suffices, and the parameters decide how
much earlier the vehicle slows down, and how far behind it stays.
"""

from math import inf, sqrt

from drivecal.domain.roads import Floats
from drivecal.highway.compilation import compiled_with
from drivecal.highway.planner import cost, plans, terms
from drivecal.highway.planner.cost import LATEST_DECELERATION
from drivecal.highway.planner.plans import SPACING
from drivecal.highway.planner.terms import DRIFT_TIME, IN_PATH_FADE

compiled = compiled_with(cost, plans, terms, error_model="numpy")

SHORTEST_GAP, SHORTEST_HEADWAY = 2.0, 0.25
"""Gap (m) and additional time headway (s) at which the desired speed is the leader's."""
EASE = 6.0
"""Metres over which the last difference of the speeds fades out."""
STEP, STEPS = 0.1, 90
"""Steps (s) of the drive behind the leader, which is foreseen beyond the horizon of the candidates."""


@compiled
def speed_behind(gap: float, speed: float) -> float:
    """Returns the largest desired speed (m/s) at a gap (m) behind a leader of this speed."""
    spare = gap - SHORTEST_GAP - SHORTEST_HEADWAY * max(speed, 0.0)
    faster = sqrt(2.0 * LATEST_DECELERATION * max(spare + EASE, 0.0)) - sqrt(2.0 * LATEST_DECELERATION * EASE)
    return max(speed + faster, 0.0)


@compiled
def follow(
    road: Floats, wanted: Floats, scene: Floats, ego: Floats, neighbours: Floats, outlines: Floats,
    followed: bool,  # noqa: FBT001  # kernels take arguments by position
) -> bool:  # fmt: skip
    """Writes the desired speeds and their changes to `road`: `wanted`, shape (n,), lowered behind the vehicle in the way, if there is any.

    Returns whether there is one. `followed` is the last call's answer.

    `road`, `scene`, `ego`, `neighbours`: as in `plans`; `outlines`, shape (m, 7): rows of the neighbours, whose last column is their
    acceleration along the road. In the way is a vehicle ahead that is less to the side than a leader that counts for P8, now or after its
    drift. A leader that brakes goes on braking.
    """
    lowest, gap, leader, braking = inf, inf, 0.0, 0.0
    for m in range(len(neighbours)):
        d, drifted = neighbours[m, 1] - ego[3], neighbours[m, 1] + DRIFT_TIME * neighbours[m, 3] - ego[3]
        if neighbours[m, 0] <= ego[0] or min(abs(d), abs(drifted)) >= scene[4] + 0.5 * neighbours[m, 5] + IN_PATH_FADE:
            continue
        space = neighbours[m, 0] - ego[0] - scene[3] - 0.5 * neighbours[m, 4]
        speed = speed_behind(space, neighbours[m, 2])
        if speed < lowest:
            lowest, gap, leader, braking = speed, space, neighbours[m, 2], max(-outlines[m, 6], 0.0)
    if lowest == inf and not followed:
        return False
    road[:, 5] = wanted
    if lowest < inf:
        last = len(road) - 1
        row = min(max(int(ego[0] / SPACING), 0), last)
        s, speed = ego[0], min(lowest, wanted[row])
        for _ in range(STEPS):
            way = speed * STEP
            gap += leader * STEP - way
            leader = max(leader - braking * STEP, min(leader, 0.0))
            following = speed_behind(gap, leader)
            while row < last and row * SPACING <= s + way:
                share = max(row * SPACING - s, 0.0) / max(way, SPACING * STEP)
                road[row, 5] = min(wanted[row], speed + share * (following - speed))
                row += 1
            s += way
            speed = min(following, wanted[row])
        while row <= last:
            road[row, 5] = min(wanted[row], speed)
            row += 1
    for row in range(len(road) - 1):
        road[row, 9] = (road[row + 1, 5] - road[row, 5]) / SPACING
    road[-1, 9] = 0.0
    return lowest < inf

"""The candidate set: the ends of lateral and longitudinal plans, and the desired speed along the road. Independent of any parameter.

Every lateral plan is combined with every longitudinal one: 24 x 12 = 288 candidates.
"""

import numpy as np
import numpy.typing as npt

from drivecal.domain.scenarios import Task
from drivecal.highway.planner.cost import LATEST_DECELERATION

Floats = npt.NDArray[np.float64]

CENTRE_HORIZONS = (7.5, 6.5, 5.5, 4.7, 4.0, 3.2, 2.5)
"""Horizons to the centre of the wanted lane, s: from a leisurely lane change (0.4 m/s² at 7.5 s) to a swerve (3.5 m/s²)."""
OFFSETS = (0.2, -0.2, 0.5, -0.5)
OFFSET_HORIZONS = (6.5, 4.5, 3.0)
"""Offset from the centre of the wanted lane, m, and horizon, s."""
KEEPING_OFFSETS = (0.9, -0.9)
"""Evasive offsets if the task has no other lane, m."""
PREPARING_OFFSET = 0.4
"""Offset from the centre of the task's other lane, if it has any, towards the wanted lane, m."""
FURTHER_HORIZONS = (5.5, 3.0)
"""Horizons of both, s."""

LONGITUDINAL_ENDS = (
    (7.5, 0.0),
    (6.7, 0.0),
    (6.0, 0.0),
    (5.3, 0.0),
    (4.4, 0.0),
    (3.2, 0.0),
    (7.5, -2.5),
    (7.5, -5.0),
    (4.5, 1.5),
    (4.5, -4.0),
    (2.5, -8.0),
)
"""(horizon in s, end speed relative to the desired speed in m/s): reach it calmly or quickly, go part of the way, overshoot to
escape a follower, slow down behind a vehicle, brake hard (5 m/s²)."""


def lateral_ends(lane_width: float, wanted_lane: int, other_lane: int) -> Floats:
    """Ends of the lateral plans, shape (2, 24): rows offset d (m) and horizon (s).

    The last column is a copy of the first; the kernel replaces it by the rest of the previous plan, so that an unchanged plan is always
    a candidate. `other_lane` is the task's other lane (equal to `wanted_lane` in lane keeping).
    """
    wanted, other = wanted_lane * lane_width, other_lane * lane_width
    if other_lane == wanted_lane:
        further = [wanted + offset for offset in KEEPING_OFFSETS]
    else:
        further = [other, other + (PREPARING_OFFSET if wanted > other else -PREPARING_OFFSET)]
    ends = [(wanted, horizon) for horizon in CENTRE_HORIZONS]
    ends += [(wanted + offset, horizon) for offset in OFFSETS for horizon in OFFSET_HORIZONS]
    ends += [(offset, horizon) for offset in further for horizon in FURTHER_HORIZONS]
    return np.ascontiguousarray(np.array([*ends, ends[0]]).T)


def longitudinal_ends() -> Floats:
    """Ends of the longitudinal plans, shape (2, n): rows end speed relative to the desired speed (m/s) and horizon (s). The last
    column is a copy of the first for the rest of the previous plan, as in `lateral_ends`."""
    ends = [(offset, horizon) for horizon, offset in LONGITUDINAL_ENDS]
    return np.ascontiguousarray(np.array([*ends, ends[0]]).T)


def desired_speeds(task: Task, s: Floats) -> Floats:
    """Returns the desired speed (m/s) at arc lengths `s` (uniform, shape (n,)): the task's, lowered ahead of a lower speed such that
    `LATEST_DECELERATION` suffices. A higher speed holds from its knot on. The first knot's speed also holds before it."""
    knots = np.array([knot.s for knot in task.speeds])
    speeds = np.array([knot.speed for knot in task.speeds])
    in_force = np.maximum(np.searchsorted(knots, s, side="right") - 1, 0)
    reachable = speeds[in_force] ** 2
    ahead = 2.0 * LATEST_DECELERATION * (s[-1] - s)
    # v²(s) <= v²(s') + 2 a (s' - s) for every s' ahead: a running minimum from the end of v² - 2 a (end - s).
    squared: Floats = np.minimum.accumulate((reachable - ahead)[::-1])[::-1] + ahead
    return np.sqrt(squared)

"""Check of the scenario's task. Pure."""

import numpy as np

from drivecal.domain.roads import Floats
from drivecal.domain.scenarios import Scenario


def target_offsets(motion: Floats, scenario: Scenario) -> Floats:
    """Returns the offsets (m, to the left) from the target lane's centre, shape (n,), of Frenet motions of shape (n, 6)."""
    offsets: Floats = motion[:, 3] - scenario.task.target_lane * scenario.road.lane_width
    return offsets


def speed_errors(motion: Floats, scenario: Scenario) -> Floats:
    """Returns the speed along the road minus the desired speed (m/s), shape (n,), of Frenet motions of shape (n, 6)."""
    knots = np.array([knot.s for knot in scenario.task.speeds])
    speeds = np.array([knot.speed for knot in scenario.task.speeds])
    current = np.maximum(np.searchsorted(knots, motion[:, 0], side="right") - 1, 0)
    errors: Floats = motion[:, 1] - speeds[current]
    return errors


def fulfilled(motion: Floats, scenario: Scenario) -> bool:
    """Returns True if the whole scenario was driven and the task's tolerances held during its last `hold` seconds.

    `motion`: the Frenet motion at the start and after each step, shape (n + 1, 6).
    """
    task = scenario.task
    steps = round(scenario.duration / scenario.step)
    if len(motion) != steps + 1:
        return False
    end = motion[-round(task.hold / scenario.step) - 1 :]
    in_lane = np.abs(target_offsets(end, scenario)).max() <= task.lane_tolerance
    at_speed = np.abs(speed_errors(end, scenario)).max() <= task.speed_tolerance
    return bool(in_lane and at_speed)

"""A planner of your own for the built-in motorway: it steers to its lane and holds speed and distance by three parameters."""

from decimal import Decimal
from math import atan2, hypot

import numpy as np

from drivecal.domain.parameters import Parameter
from drivecal.domain.roads import pose_on, reference_line

LONGEST = 2.4  # s, the period and what the vehicle's controller looks ahead
SPACE = (
    Parameter.from_step("rate", Decimal("0.2"), Decimal("1.5"), Decimal("0.05")),  # of the lane change, 1/s
    Parameter.from_step("gain", Decimal("0.1"), Decimal(1), Decimal("0.05")),  # of the speed, 1/s
    Parameter.from_step("headway", Decimal("0.8"), Decimal("2.5"), Decimal("0.1")),  # to the vehicle ahead, s
)


class LaneFollower:
    """The planner of one scenario; `Planner` in drivecal.plugins.ports says what it has to do."""

    period = 0.2

    def __init__(self, scenario):
        self.scenario, self.line = scenario, reference_line(scenario.road)

    def reset(self, parameters):
        self.rate, self.gain, self.headway = parameters

    def plan(self, observation):
        s, speed, _, d, drift, _ = observation.ego.tolist()
        rows = []
        for time in np.arange(round(LONGEST / self.scenario.step) + 1) * self.scenario.step:
            along, aside = self.accelerations(observation, time, s, speed, d, drift)
            x, y, heading, curvature, _ = pose_on(self.line, s)
            ahead = speed * (1 - curvature * d)  # inner lanes of a bend are shorter
            place = [x - d * np.sin(heading), y + d * np.cos(heading), heading + atan2(drift, ahead)]
            rows.append([time, *place, curvature + aside / max(speed, 1) ** 2, hypot(ahead, drift), along])
            s, d = s + speed * self.scenario.step, d + drift * self.scenario.step
            speed, drift = max(speed + along * self.scenario.step, 0), drift + aside * self.scenario.step
        return np.array(rows)

    def accelerations(self, observation, time, s, speed, d, drift):
        task = self.scenario.task
        lane = task.target_lane if observation.time + time >= task.lane_change_after else task.start_lane
        aside = -2 * self.rate * drift - self.rate**2 * (d - lane * self.scenario.road.lane_width)
        along = self.gain * (next(limit for start, limit in reversed(task.speeds) if start <= s) - speed)
        for other_s, other_d, other_speed, _, length, _ in observation.neighbours.tolist():
            gap = other_s + other_speed * time - s - length
            if gap > 0 and abs(other_d - d) < 2:
                along = min(along, self.gain * (gap - self.headway * speed) + other_speed - speed)
        return min(max(along, -4), 2), aside


class Plugin:
    name, version, limits = "lane_follower", "1", {}
    spaces = {"highway": SPACE}

    def create(self, scenario):
        return LaneFollower(scenario)


LANE_FOLLOWER = Plugin()

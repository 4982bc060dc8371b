"""Definitions of S1..S6 of the paper's Section IV-A on a three-lane German motorway; `highway` adds the networks and their roads.

Every scenario has relevant traffic and an excitation, so that the planner's parameters affect the drive: without either, a planner drives
well with any parameters.
"""

from functools import partial

import numpy as np

from drivecal.domain.scenarios import EgoStart, Road, Scenario, SpeedKnot, Task, TrafficVehicle
from drivecal.highway.manoeuvres import Manoeuvre

STEP = 0.1
UNREAD = b""
UNMEASURED = Road(np.zeros((0, 5)), 0.0, 0, 0.0)
"""Network and road of a scenario before its network is read."""
KMH_80 = 80.0 / 3.6


def truck(name: str, lane: int, s: float, speed: float, drift: tuple[tuple[float, float], ...] = ()) -> TrafficVehicle:
    """Returns a lorry, which is long, wide and changes its speed slowly."""
    return TrafficVehicle(
        name, lane, s, speed, speed, length=12.0, width=2.5, acceleration=0.8, deceleration=2.0, time_headway=1.8, drift=drift
    )


def drifting(s: float, speed: float, drift: tuple[tuple[float, float], ...]) -> TrafficVehicle:
    """Returns a car of constant speed that drifts in the left lane."""
    return TrafficVehicle("drifting", 2, s, speed, speed, drift=drift)


_scenario = partial(Scenario, step=STEP, network=UNREAD, road=UNMEASURED)

S1 = _scenario(
    id="S1",
    title="Change lane on a straight road to overtake a slower vehicle",
    rated_as=Manoeuvre.LANE_CHANGE,
    duration=16.0,
    route=("e0",),
    ego=EgoStart(s=150.0, d=0.0, speed=30.0),
    task=Task(start_lane=0, target_lane=1, speeds=(SpeedKnot(0.0, 30.0),), lane_change_after=0.6),
    traffic=(
        truck("slower", lane=0, s=206.0, speed=22.5),
        TrafficVehicle("follower", lane=1, s=118.0, speed=32.5, desired_speed=34.0),
        TrafficVehicle("leader", lane=1, s=215.0, speed=29.0, desired_speed=29.0),
        TrafficVehicle("behind", lane=0, s=100.0, speed=29.0, desired_speed=30.0),
        TrafficVehicle("beside", lane=2, s=130.0, speed=34.0, desired_speed=36.0),
        truck("second", lane=0, s=290.0, speed=22.5),
    ),
)

S2 = _scenario(
    id="S2",
    title="Change lane on a curved road to overtake a slower vehicle",
    rated_as=Manoeuvre.LANE_CHANGE,
    duration=18.0,
    route=("e0", "e1", "e2", "e3"),
    ego=EgoStart(s=150.0, d=0.0, speed=28.0),
    task=Task(start_lane=0, target_lane=1, speeds=(SpeedKnot(0.0, 29.0),), lane_change_after=1.5),
    traffic=(
        truck("slower", lane=0, s=212.0, speed=21.5),
        TrafficVehicle("follower", lane=1, s=112.0, speed=31.5, desired_speed=33.0),
        TrafficVehicle("leader", lane=1, s=222.0, speed=28.0, desired_speed=28.0),
        TrafficVehicle("behind", lane=0, s=108.0, speed=27.0, desired_speed=28.0),
        TrafficVehicle("beside", lane=2, s=165.0, speed=30.0, desired_speed=30.5),
        TrafficVehicle("ahead", lane=2, s=270.0, speed=31.0, desired_speed=31.5),
    ),
)

S3 = _scenario(
    id="S3",
    title="Keep the lane on a straight road between a lorry and a drifting car",
    rated_as=Manoeuvre.LANE_KEEPING,
    duration=16.0,
    route=("e0",),
    ego=EgoStart(s=150.0, d=4.2, speed=31.0, heading=0.004),
    task=Task(start_lane=1, target_lane=1, speeds=(SpeedKnot(0.0, 31.0),)),
    traffic=(
        truck("lorry", lane=0, s=196.0, speed=25.0, drift=((0.0, 0.0), (2.5, 0.0), (4.5, 1.1), (9.0, 1.1), (11.0, 0.0))),
        drifting(s=172.0, speed=30.0, drift=((0.0, 0.0), (8.5, 0.0), (10.5, -1.1), (12.5, -1.1), (14.5, 0.0))),
        TrafficVehicle("leader", lane=1, s=215.0, speed=30.5, desired_speed=30.5),
        TrafficVehicle("follower", lane=1, s=110.0, speed=31.5, desired_speed=33.0),
        truck("second", lane=0, s=115.0, speed=24.5),
        TrafficVehicle("fast", lane=2, s=80.0, speed=32.5, desired_speed=33.0),
    ),
)

S4 = _scenario(
    id="S4",
    title="Keep the lane on a curved road beside a drifting car",
    rated_as=Manoeuvre.LANE_KEEPING,
    duration=18.0,
    route=("e0", "e1", "e2", "e3"),
    ego=EgoStart(s=150.0, d=3.25, speed=29.0),
    task=Task(start_lane=1, target_lane=1, speeds=(SpeedKnot(0.0, 29.0),)),
    traffic=(
        truck("lorry", lane=0, s=225.0, speed=23.0, drift=((0.0, 0.0), (5.5, 0.0), (7.5, 1.1), (12.5, 1.1), (14.5, 0.0))),
        drifting(s=100.0, speed=32.0, drift=((0.0, 0.0), (11.0, 0.0), (13.0, -1.1), (15.5, -1.1), (17.5, 0.0))),
        TrafficVehicle("leader", lane=1, s=200.0, speed=28.5, desired_speed=28.5),
        TrafficVehicle("follower", lane=1, s=110.0, speed=30.0, desired_speed=31.0),
        truck("second", lane=0, s=115.0, speed=22.5),
        TrafficVehicle("ahead", lane=2, s=270.0, speed=32.5, desired_speed=33.0),
    ),
)

S5 = _scenario(
    id="S5",
    title="Accelerate after a traffic sign behind a slower accelerating car",
    rated_as=Manoeuvre.SPEED_CHANGE,
    duration=20.0,
    route=("e0", "e1"),
    ego=EgoStart(s=150.0, d=0.0, speed=KMH_80),
    task=Task(start_lane=0, target_lane=0, speeds=(SpeedKnot(0.0, KMH_80), SpeedKnot(230.0, 30.0)), speed_tolerance=3.0),
    traffic=(
        TrafficVehicle("leader", lane=0, s=200.0, speed=22.2, desired_speed=29.0, acceleration=1.3),
        TrafficVehicle("follower", lane=0, s=118.0, speed=22.2, desired_speed=33.0, acceleration=2.4, time_headway=0.9),
        TrafficVehicle("beside", lane=1, s=150.0, speed=22.2, desired_speed=32.0, acceleration=1.8),
        TrafficVehicle("second", lane=1, s=190.0, speed=22.2, desired_speed=30.0, acceleration=1.4),
        TrafficVehicle("behind", lane=1, s=110.0, speed=22.2, desired_speed=32.0, acceleration=1.4),
        TrafficVehicle("fast", lane=2, s=130.0, speed=23.0, desired_speed=34.0, acceleration=2.0),
    ),
)

S6 = _scenario(
    id="S6",
    title="Decelerate for a curve behind a slower car",
    rated_as=Manoeuvre.SPEED_CHANGE,
    duration=18.0,
    route=("e0", "e1", "e2", "e3"),
    ego=EgoStart(s=150.0, d=0.0, speed=32.0),
    task=Task(start_lane=0, target_lane=0, speeds=(SpeedKnot(0.0, 32.0), SpeedKnot(275.0, 23.5)), speed_tolerance=3.0),
    traffic=(
        TrafficVehicle("leader", lane=0, s=198.0, speed=31.0, desired_speed=31.0, deceleration=2.5),
        TrafficVehicle("follower", lane=0, s=110.0, speed=32.0, desired_speed=34.0, time_headway=0.9),
        TrafficVehicle("beside", lane=1, s=150.0, speed=33.0, desired_speed=34.0),
        TrafficVehicle("second", lane=1, s=240.0, speed=33.0, desired_speed=33.0),
        TrafficVehicle("behind", lane=1, s=95.0, speed=32.0, desired_speed=33.0),
        TrafficVehicle("fast", lane=2, s=190.0, speed=35.0, desired_speed=36.0),
    ),
)

DEFINITIONS: tuple[Scenario, ...] = (S1, S2, S3, S4, S5, S6)

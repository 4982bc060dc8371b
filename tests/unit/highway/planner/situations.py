"""Scenarios and planning instants to test with."""

from dataclasses import dataclass, field, replace

import numpy as np
from tests.support.roads import CurvatureKnot, road_of

from drivecal.bundles.highway import EgoStart, Scenario, Task
from drivecal.domain.roads import Floats, Road
from drivecal.highway.comfort.reference import Manoeuvre
from drivecal.highway.planner.plugin import HIGHWAY
from drivecal.plugins.ports import Observation

LANE = 3.75
MIDDLE = [0.0, 1.0, 100.0, 1000.0, 750.0, 0.5, 100.0, 1000.0, 5.0, 10.0, 100.0]
STRAIGHT = (CurvatureKnot(0.0, 0.0),)
WINDING = (
    CurvatureKnot(100.0, 0.0),
    CurvatureKnot(220.0, 1 / 700),
    CurvatureKnot(300.0, 1 / 700),
    CurvatureKnot(420.3, -1 / 500),
)


@dataclass(frozen=True, eq=False)
class Situation(Scenario):
    """A scenario on a road that no file has."""

    road: Road = field(kw_only=True)


KEEPING = Situation(
    id="keeping",
    title="Keep the middle lane of a straight road",
    rated_as=Manoeuvre.LANE_KEEPING,
    duration=10.0,
    step=0.1,
    road=road_of(1000.0, 3, LANE, STRAIGHT),
    network=b"",
    route=(),
    ego=EgoStart(s=100.0, d=LANE, speed=30.0),
    task=Task(start_lane=1, target_lane=1, speeds=[(0.0, 30.0)]),
)
CHANGING = replace(KEEPING, id="changing", task=Task(start_lane=0, target_lane=1, speeds=[(0.0, 30.0)], lane_change_after=1.0))
BENDING = replace(KEEPING, id="bending", road=road_of(1000.0, 3, LANE, WINDING))


def vehicle(s: float, lane: float, speed: float, drift: float = 0.0, length: float = 4.6, width: float = 1.9) -> list[float]:
    """A row of `Observation.neighbours`."""
    return [s, lane * LANE, speed, drift, length, width]


def seen(
    *neighbours: list[float], time: float = 0.0, s: float = 100.0, s1: float = 30.0, d: float = LANE, d1: float = 0.0
) -> Observation:
    """An observation; the ego vehicle in the middle lane at 30 m/s where nothing else is said."""
    return Observation(time, np.array([s, s1, 0.0, d, d1, 0.0]), np.array(neighbours, dtype=float).reshape(-1, 6))


def random_parameters(random: np.random.Generator) -> list[float]:
    """A random set from Table 6's space."""
    return [float(parameter.value(int(random.integers(parameter.n_values)))) for parameter in HIGHWAY]


def random_scenario(random: np.random.Generator) -> Scenario:
    """Any road, task and desired speeds."""
    lanes = int(random.integers(2, 4))
    start, target = (int(lane) for lane in random.integers(0, lanes, 2))
    speeds = [(s, float(random.uniform(15, 38))) for s in (0.0, 180.0, float(random.uniform(200, 500)))]
    task = Task(start_lane=start, target_lane=target, speeds=speeds, lane_change_after=float(random.uniform(0, 2)))
    road = road_of(600.0, lanes, LANE, (STRAIGHT, WINDING)[int(random.integers(2))])
    ego = EgoStart(s=100.0, d=start * LANE, speed=30.0, width=float(random.uniform(1.7, 2.1)))
    return replace(KEEPING, road=road, task=task, ego=ego)


def random_neighbours(random: np.random.Generator, s: float, lanes: int) -> Floats:
    """Up to six vehicles around s, some close."""
    rows = [
        vehicle(
            s + random.normal(0, 40),
            random.integers(lanes) + random.normal(0, 0.1),
            random.uniform(18, 38),
            random.normal(0, 0.3),
            *((12.0, 2.5) if random.random() < 0.3 else (4.6, 1.9)),
        )
        for _ in range(int(random.integers(0, 7)))
    ]
    return np.array(rows, dtype=float).reshape(-1, 6)


def random_drive(random: np.random.Generator, scenario: Scenario, plans: int) -> list[Observation]:
    """Observations 0.2 s apart of a vehicle that keeps its speed; the last of them far from what could have been planned."""
    start = np.array([random.uniform(-5, 620), random.uniform(12, 38), random.normal(0, 0.7), 0.0, 0.0, 0.0])
    start[3:] = random.uniform(-2.5, (scenario.road.lanes - 1) * LANE + 2.5), random.normal(0, 0.3), random.normal(0, 0.3)
    neighbours = random_neighbours(random, start[0], scenario.road.lanes)
    drive = []
    for index in range(plans):
        ego = start.copy()
        ego[0] += 0.2 * index * start[1]
        if index == plans - 1:
            ego += [3.0, -1.5, 0.0, 0.2, 0.6, 0.0]
        others = neighbours.copy()
        others[:, 0] += 0.2 * index * others[:, 2]
        drive.append(Observation(index * 0.2, ego, others))
    return drive

"""Behaviour of the planner: its trajectories, and the features that a situation changes."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import cos, sin

import numpy as np
import pytest
from tests.support.effort import tries
from tests.support.frenet import to_frenet
from tests.unit.highway.planner.considering import features_of
from tests.unit.highway.planner.reference import ReferencePlanner
from tests.unit.highway.planner.situations import BENDING, CHANGING, KEEPING, LANE, MIDDLE, random_drive, seen, vehicle

from drivecal.bundles.highway import Scenario, Task
from drivecal.domain.errors import InvalidInputError
from drivecal.domain.roads import Floats, reference_line
from drivecal.highway.planner.cost import weights
from drivecal.highway.planner.planner import PERIOD, FrenetPlanner
from drivecal.highway.planner.plans import LARGEST_THRUST, LATERAL_PLANS, LONGITUDINAL_ENDS, LONGITUDINAL_PLANS
from drivecal.plugins.ports import Observation

NOTHING = [-15.0] + 10 * [0.0]
"""All weights at their lowest: what is left is the base, and a little smoothing."""
BASE, P1, P2, P3, P4, P5, P6, P7, P8, P9, P10, P11 = range(12)


def planner_for(scenario: Scenario, parameters: Sequence[float] = MIDDLE) -> FrenetPlanner:
    planner = FrenetPlanner(scenario)
    planner.reset(parameters)
    return planner


def ideal_drive(
    scenario: Scenario,
    parameters: Sequence[float],
    duration: float,
    neighbours: Callable[[float], Sequence[Sequence[float]]] = lambda _: [],
    start: Sequence[float] | None = None,
) -> Floats:
    """Rows (t, s, s', s'', d, d', d'') every 0.2 s of a vehicle that is where its trajectory says."""
    planner, line = planner_for(scenario, parameters), reference_line(scenario.road)
    ego = [scenario.ego.s, scenario.ego.speed, 0.0, scenario.ego.d, 0.0, 0.0] if start is None else start
    rows = []
    for index in range(round(duration / PERIOD)):
        time = index * PERIOD
        rows.append([time, *ego])
        others = np.array(neighbours(time), dtype=float).reshape(-1, 6)
        row = planner.plan(Observation(time, np.array(ego), others))[round(PERIOD / scenario.step)]
        _, x, y, heading, curvature, speed, acceleration = row.tolist()
        forward, left = cos(heading), sin(heading)
        turn = speed * speed * curvature
        acceleration_xy = (acceleration * forward - turn * left, acceleration * left + turn * forward)
        ego = list(to_frenet(line, (x, y), (speed * forward, speed * left), acceleration_xy, ego[0] + speed * PERIOD))
    return np.array(rows)


@pytest.mark.parametrize("seed", range(tries(4, 12)))
def test_the_trajectory_is_the_path_of_the_chosen_candidate(seed: int) -> None:
    random = np.random.default_rng(seed)
    planner, reference = planner_for(BENDING), ReferencePlanner(BENDING)
    reference.reset(MIDDLE)
    for observation in random_drive(random, BENDING, plans=2):
        trajectory = planner.plan(observation)
        reference.start = reference.where_to_start(observation)
        reference.fit(observation)
        i, j = planner.chosen % LATERAL_PLANS, planner.chosen // LATERAL_PLANS
        for row in trajectory[1:]:
            np.testing.assert_allclose(row[1:], reference.motion(i, j, row[0]), rtol=1e-4, atol=2e-4)
        reference.before = (observation.time, reference.along[j], reference.aside[i])


def test_the_trajectory_has_a_row_per_step_and_outlasts_the_period_by_a_second() -> None:
    for step in (0.1, 0.05):
        trajectory = planner_for(replace(KEEPING, step=step)).plan(seen())
        assert trajectory.shape[1] == 7
        np.testing.assert_allclose(trajectory[:, 0], np.arange(len(trajectory)) * step)
        assert trajectory[-1, 0] >= PERIOD + 1.0
    assert PERIOD <= 0.2
    assert LATERAL_PLANS * LONGITUDINAL_PLANS >= 150


def test_a_step_that_does_not_divide_the_period_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="step"):
        FrenetPlanner(replace(KEEPING, step=0.15))


@pytest.mark.parametrize("broken", [float("nan"), float("inf")])
def test_an_observation_without_usable_numbers_is_refused(broken: float) -> None:
    planner = planner_for(KEEPING)
    with pytest.raises(ValueError, match="finite"):
        planner.plan(seen(s1=broken))
    planner.reset(MIDDLE)
    assert np.isfinite(planner.plan(seen())).all(), "the next run is not affected"


def test_a_small_deviation_leaves_the_plan_as_it_is_and_a_large_one_starts_it_anew() -> None:
    planner = planner_for(KEEPING)
    before = planner.plan(seen(d=LANE + 0.6, d1=0.2))
    after = planner.plan(seen(time=0.2, s=106.3, s1=30.1, d=LANE + 0.7))
    np.testing.assert_allclose(after[0, 1:], before[2, 1:], atol=1e-9)
    anew = planner.plan(seen(time=0.4, s=112.0, d=LANE - 0.6, d1=0.1))
    np.testing.assert_allclose(anew[0, 1:3], [112.0, LANE - 0.6])
    assert anew[0, 3] == pytest.approx(0.1 / 30.0, rel=1e-4)


def test_going_on_with_the_plan_before_is_among_the_candidates() -> None:
    planner = planner_for(KEEPING, [0.0, 0.0, 0.0, 0.0, 1e6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    before = planner.plan(seen(d=LANE + 0.6, d1=0.4))
    features = features_of(planner, seen(time=0.2, s=106.0, d=LANE + 0.67))
    after = planner.plan(seen(time=0.2, s=106.0, d=LANE + 0.67))
    assert features.reshape(-1, LATERAL_PLANS, 12)[:, -1, P5].max() == 0.0
    assert planner.chosen % LATERAL_PLANS == LATERAL_PLANS - 1
    np.testing.assert_allclose(after[:-2, 2], before[2:, 2], atol=1e-9)


AHEAD = vehicle(130, 1, 20)


def test_the_consistency_term_compares_with_the_plan_before() -> None:
    planner = planner_for(KEEPING)
    assert not features_of(planner, seen(d=LANE + 0.5))[:, P5].any(), "there is no plan before the first"
    planner.plan(seen(d=LANE + 0.5))
    assert np.ptp(features_of(planner, seen(d=LANE + 0.5, time=0.2, s=106.0))[:, P5]) > 0.05


@pytest.mark.parametrize(
    ("scenario", "d", "neighbour", "changed"),
    [
        (KEEPING, LANE, vehicle(400, 1, 30), set()),
        (KEEPING, LANE, vehicle(230, 1, 27), {P8}),
        (KEEPING, LANE, AHEAD, {BASE, P7, P8}),
        (KEEPING, LANE, vehicle(70, 1, 36), set()),
        (KEEPING, LANE, vehicle(100, 2, 30), {P7, P10}),
        (CHANGING, 0.0, vehicle(45, 1, 32), {P11}),
        (CHANGING, 0.0, vehicle(100, 1, 30), {BASE, P7, P10}),
        (CHANGING, 0.0, vehicle(40, 2, 35), {P7}),
        (CHANGING, 0.0, vehicle(60, 0, 36), set()),
    ],
    ids=["far away", "far ahead", "ahead", "behind in the lane", "beside", "follower", "in the gap", "nearing", "left behind"],
)
def test_a_neighbour_changes_its_own_features(scenario: Scenario, d: float, neighbour: list[float], changed: set[int]) -> None:
    planner = planner_for(scenario)
    alone = features_of(planner, seen(d=d, time=2.0))
    together = features_of(planner, seen(neighbour, d=d, time=2.0))
    assert (together >= alone).all(), "another vehicle never makes a candidate cheaper"
    at_speed = np.repeat(LONGITUDINAL_ENDS[0] == 0.0, LATERAL_PLANS)
    differs = {term for term in range(12) if (together[at_speed, term] != alone[at_speed, term]).any()}
    assert differs == changed


@pytest.mark.parametrize("parameters", [NOTHING, MIDDLE], ids=["base alone", "mid-range"])
def test_the_lane_is_changed_when_it_is_wanted_and_not_before(parameters: list[float]) -> None:
    drive = ideal_drive(CHANGING, parameters, 12.0, start=[100.0, 30.0, 0.0, 0.0, 0.0, 0.0])
    early = drive[drive[:, 0] <= 1.0]
    assert np.abs(early[:, 4]).max() < 0.02
    assert np.abs(drive[-5:, 4] - LANE).max() < 0.3
    assert drive[:, 4].max() < LANE + 0.5


def test_the_base_alone_keeps_the_lane_and_the_speed_on_a_winding_road() -> None:
    drive = ideal_drive(BENDING, NOTHING, 10.0, start=[100.0, 28.0, 0.0, LANE + 0.6, 0.1, 0.0])
    assert np.abs(drive[-5:, 4] - LANE).max() < 0.1
    assert np.abs(drive[-5:, 2] - 30.0).max() < 0.5


@pytest.mark.parametrize("parameters", [NOTHING, MIDDLE], ids=["base alone", "mid-range"])
def test_a_slower_vehicle_ahead_is_never_hit(parameters: list[float]) -> None:
    drive = ideal_drive(KEEPING, parameters, 20.0, lambda time: [vehicle(180 + 22 * time, 1, 22)])
    distance = 180 + 22 * drive[:, 0] - drive[:, 1]
    beside = np.abs(drive[:, 4] - LANE) > 1.9
    assert ((distance > 4.75) | beside).all()


def test_a_lower_limit_is_reached_in_time_and_a_higher_one_not_used_too_early() -> None:
    slower = replace(KEEPING, task=Task(start_lane=1, target_lane=1, speeds=[(0.0, 30.0), (350.0, 22.0)]))
    drive = ideal_drive(slower, MIDDLE, 14.0)
    speed_at_sign = np.interp(350.0, drive[:, 1], drive[:, 2])
    assert speed_at_sign < 23.5
    assert drive[:, 3].min() > -3.5
    faster = replace(KEEPING, task=Task(start_lane=1, target_lane=1, speeds=[(0.0, 22.0), (250.0, 30.0)]))
    drive = ideal_drive(faster, MIDDLE, 16.0, start=[100.0, 22.0, 0.0, LANE, 0.0, 0.0])
    assert drive[drive[:, 1] < 250.0, 2].max() < 22.2
    assert drive[-1, 2] > 27.0


def test_a_candidate_that_cannot_be_driven_is_passed_over() -> None:
    planner = planner_for(KEEPING, NOTHING)
    costs = features_of(planner, seen(s1=14.0)) @ weights(NOTHING)
    trajectory = planner.plan(seen(s1=14.0))
    assert costs.min() < costs[planner.chosen], "gaining 16 m/s in 2.5 s would be cheapest"
    assert trajectory[:, 6].max() <= LARGEST_THRUST


def test_where_nothing_can_be_driven_the_cheapest_candidate_is() -> None:
    planner = planner_for(KEEPING)
    costs = features_of(planner, seen(d=3 * LANE, d1=3.0)) @ weights(MIDDLE)
    assert np.isfinite(planner.plan(seen(d=3 * LANE, d1=3.0))).all()
    assert planner.chosen == np.argmin(costs)


def test_a_vehicle_at_a_standstill_gets_a_trajectory() -> None:
    trajectory = planner_for(KEEPING).plan(seen(s1=0.0))
    assert np.isfinite(trajectory).all()
    assert trajectory[0, 5] == 0.0
    assert trajectory[-1, 1] > trajectory[0, 1]

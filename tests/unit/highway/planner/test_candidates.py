"""The candidate set and the desired speed along the road."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.bundles.highway import Task
from drivecal.highway.planner import plans
from drivecal.highway.planner.cost import LATEST_DECELERATION
from drivecal.highway.planner.lanes import LANES
from drivecal.highway.planner.plans import LONGITUDINAL_ENDS, desired_speeds, lateral_ends
from drivecal.highway.planner.terms import TIMES

S = np.linspace(0.0, 500.0, 1001)


def speeds_along(*knots: tuple[float, float]) -> list[float]:
    speeds: list[float] = desired_speeds(Task(start_lane=0, target_lane=0, speeds=list(knots)), S).tolist()
    return speeds


@pytest.mark.parametrize(("wanted", "other"), [(0, 0), (1, 1), (1, 0), (0, 1)])
def test_there_are_enough_candidates_and_the_first_is_the_wanted_one(wanted: int, other: int) -> None:
    lateral, longitudinal = lateral_ends(3.5, wanted, other), LONGITUDINAL_ENDS
    assert lateral.shape[1] * longitudinal.shape[1] >= 150
    assert lateral[0, 0] == wanted * 3.5
    assert longitudinal[0, 0] == 0.0
    assert (lateral[:, -1] == lateral[:, 0]).all(), "the place of the plan before"
    assert min(lateral[1].min(), longitudinal[1].min()) >= 2.0
    assert lateral.flags.c_contiguous
    assert len({*map(tuple, lateral[:, :-1].T.tolist())}) == lateral.shape[1] - 1, "no candidate twice"
    assert (longitudinal[:, -1] == longitudinal[:, 0]).all()
    assert longitudinal.flags.c_contiguous
    assert len({*map(tuple, longitudinal[:, :-1].T.tolist())}) == longitudinal.shape[1] - 1


def test_the_other_lane_of_the_task_is_offered_and_no_third_one() -> None:
    ends = lateral_ends(3.5, 1, 0)[0]
    assert 0.0 in ends
    assert ends.min() > -1.0
    assert ends.max() < 3.5 + 1.0


def test_lane_keeping_offers_both_sides_alike() -> None:
    ends = lateral_ends(3.5, 1, 1)
    mirrored = np.array([7.0 - ends[0], ends[1]])
    assert sorted(np.round(ends.T, 9).tolist()) == sorted(np.round(mirrored.T, 9).tolist())


def test_a_lower_speed_is_reached_with_comfortable_deceleration_and_a_higher_one_begins_at_its_knot() -> None:
    speeds = speeds_along((0.0, 30.0), (300.0, 20.0), (400.0, 25.0))
    assert speeds[0] == pytest.approx(30.0)
    assert speeds[600] == pytest.approx(20.0)
    assert speeds[799] == pytest.approx(20.0)
    assert speeds[800] == pytest.approx(25.0)
    assert speeds[500] == pytest.approx(min(30.0, np.sqrt(20.0**2 + 2 * LATEST_DECELERATION * 50.0)))


@given(st.lists(st.tuples(st.floats(0, 480), st.floats(5, 40)), min_size=1, max_size=6, unique_by=lambda knot: round(knot[0])))
def test_the_desired_speed_never_exceeds_the_task_nor_asks_for_hard_braking(knots: list[tuple[float, float]]) -> None:
    knots = sorted(knots)
    speeds = np.array(speeds_along(*knots))
    task = np.array([next((speed for s, speed in reversed(knots) if s <= here), knots[0][1]) for here in S])
    assert (speeds <= task + 1e-9).all()
    assert (np.diff(speeds**2) >= -2 * LATEST_DECELERATION * 0.5 - 1e-9).all()
    later = np.minimum.accumulate(task[::-1])[::-1]
    assert (speeds >= later - 1e-9).all()


def test_the_kernels_are_compiled_for_as_many_plans_as_there_are_in_whole_blocks() -> None:
    assert lateral_ends(3.75, 0, 1).shape == lateral_ends(3.75, 1, 1).shape == (2, plans.LATERAL_PLANS)
    assert LONGITUDINAL_ENDS.shape == (2, plans.LONGITUDINAL_PLANS)
    assert plans.LATERAL_PLANS % LANES == 0
    assert plans.POINTS <= TIMES == -(-plans.POINTS // LANES) * LANES
    places = [plans.place_of(plan, plans.LATERAL_PLANS) for plan in range(plans.LATERAL_PLANS)]
    assert sorted(places) == list(range(plans.LATERAL_PLANS))
    assert places[-1] == 0, "the rest of the previous plan comes first"

"""The compiled planner against the one written out in `reference`."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.effort import tries
from tests.unit.highway.planner import exhaustive
from tests.unit.highway.planner.considering import considered, features_of
from tests.unit.highway.planner.reference import ReferencePlanner
from tests.unit.highway.planner.situations import (
    BENDING,
    CHANGING,
    KEEPING,
    LANE,
    MIDDLE,
    random_drive,
    random_parameters,
    random_scenario,
    seen,
)

from drivecal.bundles.highway import Scenario
from drivecal.domain.roads import Floats
from drivecal.highway.planner.cost import weights
from drivecal.highway.planner.planner import FrenetPlanner
from drivecal.highway.planner.plans import LATERAL_PLANS
from drivecal.highway.planner.plugin import HIGHWAY
from drivecal.highway.planner.terms import FEATURE_GRID
from drivecal.plugins.ports import Observation

GRID = 1 / FEATURE_GRID


def assert_same(planner: FrenetPlanner, reference: ReferencePlanner, observation: Observation) -> None:
    features = features_of(planner, observation)
    costs = costs_of(planner, observation)
    planner.plan(observation)
    expected = reference.plan(observation)
    # Rounding to the grid turns a difference of 1e-12 into a whole grid step where a raw feature lies between two.
    between = np.abs((reference.raw * FEATURE_GRID) % 1.0 - 0.5) < 1e-6 * (1 + reference.raw)
    np.testing.assert_allclose(features[~between], reference.features[~between], rtol=1e-9, atol=1e-12)
    assert np.abs(features - reference.features).max() <= GRID + 1e-9 * features.max()
    if not between.any():
        np.testing.assert_allclose(costs, reference.costs, rtol=1e-9, atol=1e-12)
        assert planner.chosen == expected


@cache
def planner_of(scenario: Scenario) -> FrenetPlanner:
    """One planner per scenario: tests reset it."""
    return FrenetPlanner(scenario)


def costs_of(planner: FrenetPlanner, observation: Observation) -> Floats:
    """J of all candidates, in the kernel's own arithmetic, shape (n_candidates,)."""
    return exhaustive.costs_of(*considered(planner, observation), planner._weights).ravel()


def both(seed: int) -> tuple[np.random.Generator, Scenario, FrenetPlanner, ReferencePlanner]:
    """The planner and the reference in a random scenario, with the same parameters."""
    random = np.random.default_rng(seed)
    scenario = random_scenario(random)
    planner, reference = FrenetPlanner(scenario), ReferencePlanner(scenario)
    parameters = random_parameters(random)
    planner.reset(parameters)
    reference.reset(parameters)
    return random, scenario, planner, reference


@pytest.mark.slow("0", "1", "2")
@pytest.mark.parametrize("seed", range(tries(3, 16)))
def test_features_costs_and_decisions_are_those_of_the_reference(seed: int) -> None:
    random, scenario, planner, reference = both(seed)
    for observation in random_drive(random, scenario, plans=3):
        assert_same(planner, reference, observation)


@pytest.mark.slow
def test_plans_that_come_to_their_end_are_judged_as_by_the_reference() -> None:
    went_on = set()
    for seed in range(3):
        random, scenario, planner, reference = both(seed)
        observation = random_drive(random, scenario, plans=1)[0]
        for _ in range(5):
            assert_same(planner, reference, observation)
            assert reference.before is not None
            time, ahead, aside = reference.before
            elapsed = 0.5 * (ahead.horizon + aside.horizon)
            ego = [*(ahead(elapsed, order) for order in range(3)), *(aside(elapsed, order) for order in range(3))]
            observation = Observation(time + elapsed, np.array(ego), observation.neighbours)
            went_on.add((reference.goes_on_aside, reference.goes_on_ahead))
    assert went_on & {(True, False), (False, True)}, "only one of the two has come to its end"


def test_random_situations_reach_every_feature_and_infeasible_candidates() -> None:
    occurrences = np.zeros(12)
    infeasible = 0
    for seed in range(40):
        random = np.random.default_rng(seed)
        scenario = random_scenario(random)
        planner = FrenetPlanner(scenario)
        planner.reset(random_parameters(random))
        for observation in random_drive(random, scenario, plans=3):
            features = features_of(planner, observation)
            assert features.min() >= 0.0
            occurrences += features.max(axis=0) > 0.1
            infeasible += bool(exhaustive.decide(planner, observation, planner._weights)[1].any())
            planner.plan(observation)
    assert occurrences.min() >= 5
    assert infeasible >= 3


parameters_of_table6 = st.tuples(*(st.integers(0, each.n_values - 1).map(each.value).map(float) for each in HIGHWAY))


@given(parameters_of_table6, parameters_of_table6, st.integers(0, 10_000))
def test_costs_are_linear_in_the_weights(some: tuple[float, ...], others: tuple[float, ...], seed: int) -> None:
    observation = random_drive(np.random.default_rng(seed), CHANGING, plans=1)[0]
    planner = planner_of(CHANGING)
    planner.reset(some)
    features = features_of(planner, observation)
    np.testing.assert_allclose(costs_of(planner, observation), features @ weights(some), rtol=1e-12)
    planner.reset(others)
    assert features_of(planner, observation).tobytes() == features.tobytes()
    np.testing.assert_allclose(costs_of(planner, observation), features @ weights(others), rtol=1e-12)


extreme_weights = st.lists(st.sampled_from([0.0, 1e-3, 1.0, 40.0, 1e6, -2.0]), min_size=12, max_size=12).map(np.array)


@given(st.integers(0, 10_000), st.sampled_from([KEEPING, CHANGING, BENDING]), st.one_of(parameters_of_table6, extreme_weights))
def test_bounds_leave_out_no_chosen_candidate(seed: int, scenario: Scenario, parameters: tuple[float, ...] | Floats) -> None:
    planner = planner_of(scenario)
    planner.reset(MIDDLE)
    planner._weights = parameters if isinstance(parameters, np.ndarray) else weights(parameters)
    for observation in random_drive(np.random.default_rng(seed), scenario, plans=3):
        chosen, _ = exhaustive.decide(planner, observation, planner._weights)
        planner.plan(observation)
        assert planner.chosen == chosen


def test_ties_go_to_the_lowest_index_that_is_feasible() -> None:
    planner = planner_of(KEEPING)
    for observation, first in ((seen(), 0), (seen(s1=14.0), None)):
        planner.reset(MIDDLE)
        planner._weights = np.zeros(12)
        _, infeasible = exhaustive.decide(planner, observation, planner._weights)
        planner.plan(observation)
        assert infeasible[: planner.chosen].all(), "all cost nothing"
        assert not infeasible[planner.chosen :].any()
        assert first is None or planner.chosen == first


@pytest.mark.parametrize("seed", range(20))
def test_a_vehicle_that_has_nothing_to_do_takes_candidate_0_whatever_the_parameters(seed: int) -> None:
    planner = planner_of(KEEPING)
    planner.reset(random_parameters(np.random.default_rng(seed)))
    features = features_of(planner, seen())
    planner.plan(seen())
    assert planner.chosen == 0
    assert (features[::LATERAL_PLANS] @ np.ones(12) == 0).sum() > 1, "there is no tie to break"


MIRROR = np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0])
AXIS = np.array([0.0, 0.0, 0.0, 2 * LANE, 0.0, 0.0])


@given(st.integers(0, 10_000), parameters_of_table6)
def test_a_mirrored_situation_costs_the_same_on_the_other_side(seed: int, parameters: tuple[float, ...]) -> None:
    planner = planner_of(KEEPING)
    (observation,) = random_drive(np.random.default_rng(seed), KEEPING, plans=1)
    mirrored = Observation(0.0, AXIS + MIRROR * observation.ego, observation.neighbours.copy())
    mirrored.neighbours[:, 1] = 2 * LANE - mirrored.neighbours[:, 1]
    mirrored.neighbours[:, 3] *= -1.0
    ends = planner._lateral_ends[0]
    partner = [int(np.flatnonzero(((ends.T - [2 * LANE - d, horizon]) ** 2).sum(axis=1) < 1e-9)[0]) for d, horizon in ends.T]
    planner.reset(parameters)
    shape = (-1, LATERAL_PLANS, 12)
    here = features_of(planner, observation).reshape(shape)
    there = features_of(planner, mirrored).reshape(shape)[:, partner]
    np.testing.assert_allclose(here, there, atol=1.01 * GRID, rtol=1e-9)

"""A stored planning state decides as the planner did, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.unit.highway.planner import exhaustive

from drivecal.highway.planner import deciding


def random_state(seed: int, n_longitudinal: int, n_lateral: int) -> tuple[np.ndarray, ...]:
    generator = np.random.default_rng(seed)
    shapes = (6, n_lateral), (2, n_longitudinal), (7, n_longitudinal, n_lateral)
    return tuple(np.floor(generator.exponential(3.0, shape) * 256) / 256 for shape in shapes)


@given(st.integers(0, 10_000), st.integers(1, 6), st.integers(1, 9))
def test_the_cost_of_a_stored_candidate_is_that_of_the_plan(seed: int, n_longitudinal: int, n_lateral: int) -> None:
    """`walk` must choose the cheapest candidate in the planner's order of summation: with one node whose children are all candidates."""
    lateral, longitudinal, combined = random_state(seed, n_longitudinal, n_lateral)
    generator = np.random.default_rng(seed)
    weights = generator.exponential(1.0, 12) * generator.choice([0.0, 0.1, 30.0], 12)
    n = n_longitudinal * n_lateral
    infeasible = generator.random(n) < 0.4
    costs = exhaustive.costs_of(lateral, longitudinal, combined, weights)
    expected = exhaustive.cheapest(costs, infeasible)
    if expected < 0:
        expected = exhaustive.cheapest(costs, np.zeros(n, dtype=np.bool_))
    values = np.empty((n, len(deciding.TERM)))
    deciding.values_of(lateral, longitudinal, combined, np.arange(n), values)
    packed = (values * 256).astype(np.uint16)
    rows = np.zeros(n + 1, dtype=np.int64), np.array([n, *([0] * n)], dtype=np.int32)
    none = np.zeros(n + 1, dtype=np.int32), np.zeros(n + 1, dtype=np.int32), np.zeros(0, dtype=np.int32), np.zeros(0)
    first = np.array([1, *([-1] * n)], dtype=np.int32)
    siblings = np.array([-1, *range(2, n + 1), -1], dtype=np.int32)
    decision = np.array([-1, *range(n)], dtype=np.int32)
    candidate = (np.arange(n) + deciding.INFEASIBLE * infeasible).astype(np.uint16)
    reached = deciding.walk(weights, 0, 1 / 256, packed, candidate, *rows, *none, first, siblings, decision)
    assert reached == expected + 1


def test_features_added_up_by_weight_give_the_cost() -> None:
    lateral, longitudinal, combined = random_state(4, 3, 5)
    weights = np.random.default_rng(4).exponential(1.0, 12)
    costs, features = exhaustive.costs_of(lateral, longitudinal, combined, weights), np.empty((15, 12))
    deciding.by_term(lateral, longitudinal, combined, features)
    assert features @ weights == pytest.approx(costs.ravel(), rel=1e-12)

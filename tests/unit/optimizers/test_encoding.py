"""Bit patterns and grid indices."""

from decimal import Decimal
from fractions import Fraction
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.bundles.expressions import Constraint
from drivecal.campaigns.resolve.optimizer import Optimization
from drivecal.contracts.campaign import Repaired
from drivecal.domain.constraints import Constraints
from drivecal.domain.errors import InvalidInputError
from drivecal.domain.parameters import Indices, Parameter, ParameterSpace
from drivecal.optimizers.built_in import GENETIC, RANDOM, SWARM
from drivecal.optimizers.genetic import BitEncoding
from drivecal.optimizers.repair import RepairingOptimizer
from drivecal.plugins.ports import OptimizerPlugin, Proposal

sizes = st.integers(2, 5000)
grids = st.lists(sizes, min_size=1, max_size=12).map(lambda found: np.array(found, dtype=np.int64))
seeds = st.integers(0, 2**32)


@given(grids)
def test_each_parameter_gets_the_fewest_bits_that_hold_its_values(n_values: Indices) -> None:
    for n, k in zip(n_values.tolist(), BitEncoding(n_values).bits.tolist(), strict=True):
        assert 2**k >= n > 2 ** (k - 1)


@given(grids, seeds)
def test_every_chromosome_survives_the_way_to_patterns_and_back(n_values: Indices, seed: int) -> None:
    encoding = BitEncoding(n_values)
    chromosomes = np.random.default_rng(seed).random((20, int(encoding.bits.sum()))) < 0.5
    assert np.array_equal(encoding.chromosomes(encoding.from_chromosomes(chromosomes)), chromosomes)


@given(st.integers(2, 2500))
def test_patterns_mean_the_nearest_index_and_no_tie_ever_needs_a_rule(n: int) -> None:
    encoding = BitEncoding(np.array([n]))
    largest = 2 ** int(encoding.bits[0]) - 1
    patterns = np.arange(largest + 1)
    exact = [Fraction(b * (n - 1), largest) for b in patterns.tolist()]
    assert all(value % 1 != Fraction(1, 2) for value in exact)
    assert encoding.indices(patterns[:, np.newaxis])[:, 0].tolist() == [round(value) for value in exact]


@given(sizes)
def test_patterns_cover_the_whole_grid_in_order_and_no_index_has_more_than_two(n: int) -> None:
    encoding = BitEncoding(np.array([n]))
    result = encoding.indices(np.arange(2 ** int(encoding.bits[0]))[:, np.newaxis])[:, 0]
    assert result[0] == 0
    assert result[-1] == n - 1
    assert np.all(np.diff(result) >= 0)
    assert np.bincount(result, minlength=n).min() >= 1
    assert np.bincount(result, minlength=n).max() <= 2


def test_the_most_significant_bit_comes_first() -> None:
    encoding = BitEncoding(np.array([4, 8]))
    assert encoding.chromosomes(np.array([[2, 1]])).tolist() == [[True, False, False, False, True]]


def test_a_space_without_searched_parameters_and_one_with_a_single_value_are_refused() -> None:
    with pytest.raises(InvalidInputError):
        BitEncoding(np.array([], dtype=np.int64))
    with pytest.raises(InvalidInputError, match="`fixed`"):
        BitEncoding(np.array([5, 1]))


CURVE = [f"k{number}" for number in range(8)]
MONOTONE = " >= ".join(CURVE)
SPACE = ParameterSpace(tuple(Parameter.from_step(name, Decimal(0), Decimal(2), Decimal("0.02")) for name in CURVE))
CONSTRAINTS = Constraints(SPACE, {MONOTONE: Constraint(MONOTONE, dict.fromkeys(CURVE, ()))})


def test_replaced_proposals_and_new_sets_are_counted() -> None:
    proposed = np.array([[1, 1], [2, 2], [3, 3], [3, 3], [4, 4], [5, 5]])
    repaired = np.array([[1, 1], [1, 1], [7, 7], [7, 7], [8, 8], [9, 9]])
    optimizer = RepairingOptimizer(Mock(ask=lambda: Proposal(proposed, np.ones(6, dtype=np.bool_))), lambda _: repaired)
    optimizer.known.add((8, 8))
    assert optimizer.ask().population.tolist() == repaired.tolist()
    first = optimizer.repaired
    assert first == Repaired(proposed=4, distinct=2)
    assert first + first == Repaired(proposed=8, distinct=4)
    assert optimizer.again == [1, 3, 4]


@pytest.mark.parametrize(("proposed", "distinct", "collapses"), [(0, 0, False), (10, 1, False), (11, 1, True), (5, 0, True)])
def test_fewer_than_a_tenth_of_new_sets_is_a_collapse(proposed: int, distinct: int, *, collapses: bool) -> None:
    assert Repaired(proposed=proposed, distinct=distinct).collapses is collapses


@pytest.mark.parametrize("plugin", [GENETIC, RANDOM, SWARM], ids=lambda plugin: plugin.name)
def test_a_start_population_within_constraints_is_drawn_there(plugin: OptimizerPlugin) -> None:
    given = np.array([[90, 80, 70, 60, 50, 40, 30, 20]])
    optimization = Optimization(plugin, plugin.settings(population=200), None, 5)
    population = optimization.begin(CONSTRAINTS, given).ask().population
    assert CONSTRAINTS.feasible(population).all()
    assert population[:1].tolist() == given.tolist()
    assert len(np.unique(population, axis=0)) >= 198
    assert population.tolist() == optimization.begin(CONSTRAINTS, given).ask().population.tolist()

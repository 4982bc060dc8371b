"""Bit patterns and grid indices."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.domain.errors import InvalidInputError
from drivecal.domain.parameters import Indices
from drivecal.optimizers.genetic import BitEncoding

sizes = st.integers(2, 5000)
grids = st.lists(sizes, min_size=1, max_size=12).map(lambda found: np.array(found, dtype=np.int64))
seeds = st.integers(0, 2**32)


def some_indices(n_values: Indices, seed: int, count: int = 20) -> Indices:
    return np.random.default_rng(seed).integers(0, n_values, size=(count, len(n_values)))


@given(grids)
def test_each_parameter_gets_the_fewest_bits_that_hold_its_values(n_values: Indices) -> None:
    for n, k in zip(n_values.tolist(), BitEncoding(n_values).bits.tolist(), strict=True):
        assert 2**k >= n > 2 ** (k - 1)


@given(grids, seeds)
def test_every_index_survives_the_way_to_bits_and_back(n_values: Indices, seed: int) -> None:
    encoding = BitEncoding(n_values)
    indices = some_indices(n_values, seed)
    chromosomes = encoding.chromosomes(encoding.patterns(indices))
    assert chromosomes.shape == (len(indices), int(encoding.bits.sum()))
    assert np.array_equal(encoding.indices(encoding.from_chromosomes(chromosomes)), indices)


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


def test_a_space_without_searched_parameters_is_refused() -> None:
    with pytest.raises(InvalidInputError):
        BitEncoding(np.array([], dtype=np.int64))


def test_a_parameter_with_a_single_value_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="`fixed`"):
        BitEncoding(np.array([5, 1]))

"""Recombination, mutation, ranking and start designs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from drivecal.optimizers.genetic import mutate, pairs_per_generation, recombine
from drivecal.optimizers.population import Design, ranking, start_population

seeds = st.integers(0, 2**32)
numbers = st.lists(st.sampled_from([0.0, 0.5, 1.0, float("nan")]), min_size=1, max_size=30)


@given(seeds, st.integers(1, 40), st.integers(1, 100))
def test_a_child_is_one_parent_with_one_stretch_of_the_other(seed: int, n: int, n_bits: int) -> None:
    first, second = np.zeros((n, n_bits), dtype=np.bool_), np.ones((n, n_bits), dtype=np.bool_)
    children = recombine(first, second, np.random.default_rng(seed))
    edges = np.abs(np.diff(children.astype(int), axis=1, prepend=0, append=0)).sum(axis=1)
    assert np.array_equal(edges, np.full(n, 2))


def test_every_pair_of_cuts_is_equally_likely() -> None:
    n, n_bits = 30_000, 5
    first, second = np.zeros((n, n_bits), dtype=np.bool_), np.ones((n, n_bits), dtype=np.bool_)
    children = recombine(first, second, np.random.default_rng(3))
    _, counts = np.unique(children, axis=0, return_counts=True)
    assert len(counts) == (n_bits + 1) * n_bits / 2
    assert stats.chisquare(counts).pvalue > 1e-4


@given(seeds, st.integers(1, 40), st.integers(1, 100), st.floats(0, 1))
def test_mutation_flips_at_most_one_bit_of_a_child(seed: int, n: int, n_bits: int, probability: float) -> None:
    generator = np.random.default_rng(seed)
    before = generator.random((n, n_bits)) < 0.5
    flips = (mutate(before, probability, generator) != before).sum(axis=1)
    assert flips.max() <= 1


def test_mutation_strikes_children_with_its_probability_and_bits_uniformly() -> None:
    mutants = mutate(np.zeros((20_000, 8), dtype=np.bool_), 0.5, np.random.default_rng(2))
    assert stats.binomtest(int(mutants.sum()), 20_000, 0.5).pvalue > 1e-4
    assert stats.chisquare(mutants.sum(axis=0)).pvalue > 1e-4


def test_operators_leave_their_arguments_alone() -> None:
    first, second = np.zeros((9, 6), dtype=np.bool_), np.ones((9, 6), dtype=np.bool_)
    mutate(recombine(first, second, np.random.default_rng(1)), 1.0, np.random.default_rng(1))
    mutate(first, 1.0, np.random.default_rng(1))
    assert not first.any()
    assert second.all()


@pytest.mark.parametrize(
    ("population", "selection", "recombination", "children"),
    [(1000, 0.8, 0.7, 280), (500, 0.8, 0.7, 140), (350, 0.8, 0.7, 98), (10, 0.8, 0.7, 3), (2, 0.8, 0.7, 1), (100, 1, 1, 50)],
)
def test_half_as_many_children_as_parents(population: int, selection: float, recombination: float, children: int) -> None:
    assert pairs_per_generation(population, selection, recombination) == children


def test_objectives_that_differ_only_by_the_order_of_summation_are_equal() -> None:
    objectives = np.array([0.1 + 0.2 + 0.3, 0.3 + 0.2 + 0.1])
    assert objectives[0] > objectives[1]
    assert ranking(objectives, np.array([1.0, 2.0])).tolist() == [1, 0]


@given(numbers, seeds)
def test_a_ranking_is_a_permutation_sorted_by_its_keys(objectives: list[float], seed: int) -> None:
    ratings = np.random.default_rng(seed).choice([0.0, 1.0, np.nan], len(objectives))
    order = ranking(np.array(objectives), ratings).tolist()
    assert sorted(order) == list(range(len(objectives)))

    def key(position: int) -> tuple[float, float, int]:
        objective, rating = objectives[position], float(ratings[position])
        return (
            -objective if objective == objective else np.inf,  # NaN differs from itself
            -rating if rating == rating else np.inf,
            position,
        )

    assert order == sorted(order, key=key)


@given(st.integers(1, 60), seeds)
def test_a_latin_hypercube_uses_each_value_once_where_there_are_as_many_as_points(size: int, seed: int) -> None:
    result = start_population("lhs", size, np.array([size, size, size]), np.random.default_rng(seed))
    assert np.array_equal(np.sort(result, axis=0), np.repeat(np.arange(size)[:, np.newaxis], 3, axis=1))


@pytest.mark.parametrize("design", ["lhs", "halton"])
@given(n_values=st.lists(st.integers(2, 3000), min_size=1, max_size=11), size=st.integers(1, 80), seed=seeds)
def test_start_populations_lie_on_the_grid(design: Design, n_values: list[int], size: int, seed: int) -> None:
    result = start_population(design, size, np.array(n_values), np.random.default_rng(seed))
    assert result.shape == (size, len(n_values))
    assert result.min() >= 0
    assert np.all(result < np.array(n_values))


def test_halton_starts_are_the_same_for_every_seed_and_latin_hypercubes_are_not() -> None:
    n_values = np.array([50, 60, 70])

    def start(design: Design, seed: int) -> list[list[int]]:
        result: list[list[int]] = start_population(design, 40, n_values, np.random.default_rng(seed)).tolist()
        return result

    assert start("halton", 1) == start("halton", 2)
    assert start("lhs", 1) == start("lhs", 1)
    assert start("lhs", 1) != start("lhs", 2)


def test_halton_points_are_radical_inverses() -> None:
    result = start_population("halton", 4, np.array([8, 9]), np.random.default_rng(1))
    assert result.tolist() == [[4, 3], [2, 6], [6, 1], [1, 4]]  # 1/2 1/4 3/4 1/8 and 1/3 2/3 1/9 4/9 of the grid


@pytest.mark.parametrize("design", ["lhs", "halton"])
def test_the_other_points_and_the_search_are_those_without_expert_sets(design: Design) -> None:
    """A rerun from the best set asks for the points of the first campaign, whose results are stored."""
    n_values, given_sets = np.array([50, 60]), np.array([[1, 2], [3, 4]])
    generators = [np.random.default_rng(1), np.random.default_rng(1), np.random.default_rng(1)]
    without = start_population(design, 30, n_values, generators[0])
    for count, generator in enumerate(generators[1:], start=1):
        result = start_population(design, 30, n_values, generator, given_sets[:count])
        assert np.array_equal(result[count:], without[: 30 - count])
        assert generator.bit_generator.state == generators[0].bit_generator.state


def test_more_expert_sets_than_individuals_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\b3\b.*\b2\b"):
        start_population("lhs", 2, np.array([9, 9]), np.random.default_rng(1), np.zeros((3, 2), dtype=np.int64))

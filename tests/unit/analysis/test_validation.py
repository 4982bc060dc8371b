"""The sets of Section V: all effects of the reducible parameters covered, and variants that stay in their regions."""

from collections.abc import Sequence
from decimal import Decimal
from itertools import combinations, pairwise, product

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples
from tests.support.values import present

from drivecal.analysis.validation import MOST_EXACT, Differences, ReducibleSpace, _kept, coverage, design, generator
from drivecal.bundles.expressions import Constraint
from drivecal.domain.constraints import Constraints
from drivecal.domain.parameters import Indices, Parameter, ParameterSpace
from drivecal.optimizers.built_in import GENETIC, GeneticSettings

EVERY = np.arange(10)
LOW = np.array([-1, -1, -1, 3, 4, 5, 6, 7, 8, 9])
BOTH = np.array([-1, -1, 2, 3, 4, 5, 6, 99, 99, 99])
SINGLE = np.array([-1, 1, 2, 3, 4, 5, 6, 7, 8, 99])
FREE = np.zeros(10, dtype=np.int64)


def classified(classes: Sequence[Indices]) -> ReducibleSpace:
    """Returns a space whose regions are the values of one class. `classes` has an array of shape (n_values,) for each parameter."""
    regions = [[tuple(np.flatnonzero(listed == number).tolist()) for number in np.unique(listed)] for listed in classes]
    return ReducibleSpace(np.array([len(listed) for listed in classes]), regions)


def brute_force(masks: npt.NDArray[np.bool_], orders: int) -> tuple[int, int]:
    n = masks.shape[1]
    subsets = [combination for order in range(1, orders + 1) for combination in combinations(range(n), order)]
    return len(subsets), sum(any(mask[list(subset)].all() for mask in masks) for subset in subsets)


@given(st.integers(1, 6).flatmap(lambda n: st.lists(st.lists(st.booleans(), min_size=n, max_size=n), max_size=12).map(
    lambda rows: np.array(rows, dtype=np.bool_).reshape(-1, n))))  # fmt: skip
def test_coverage_counts_what_enumeration_counts(masks: npt.NDArray[np.bool_]) -> None:
    result = coverage(masks)
    assert (result.effects, result.covered) == brute_force(masks, masks.shape[1])
    assert result.complete == (result.covered == 2 ** masks.shape[1] - 1)


@given(seed=st.integers(0, 50))
@settings(max_examples=examples(10))
def test_beyond_sixteen_parameters_effects_of_up_to_three_are_counted(seed: int) -> None:
    masks = np.random.default_rng(seed).random((6, MOST_EXACT + 2)) < 0.4
    result = coverage(masks)
    assert (result.effects, result.covered) == brute_force(masks, 3)


def test_a_parameter_is_reducible_where_a_region_has_more_than_one_value() -> None:
    assert classified([EVERY, LOW, BOTH, SINGLE, FREE]).reducible.tolist() == [1, 2, 4]


def test_where_nothing_can_be_reduced_there_is_nothing_to_validate() -> None:
    assert design(classified([EVERY, SINGLE]), 20, 5, 1, 1000) is None


@given(seed=st.integers(0, 1000), references=st.integers(1, 6))
@settings(max_examples=examples(30))
def test_variants_differ_inside_their_regions_only(seed: int, references: int) -> None:
    classes = [EVERY, LOW, BOTH, FREE]
    result = present(design(classified(classes), 16, references, seed, 4096))
    assert result.variants.shape == (len(result.bases), references, 4)
    for base, variants in zip(result.bases, result.variants, strict=True):
        for variant in variants:
            assert (variant != base).any()
            for column, one in enumerate(classes):
                assert one[variant[column]] == one[base[column]]


def test_samples_grow_until_every_effect_is_covered_and_are_kept_as_far_as_they_are_needed() -> None:
    space = classified([LOW, LOW, LOW, LOW])
    result = present(design(space, 4, 3, 1, 100_000))
    assert result.coverage.complete
    assert result.coverage.effects == 15
    assert result.drawn > 4
    assert len(result.bases) == 4
    assert space.variable(result.bases).all(axis=1).sum() == 1, "one varies in all four, and covers every effect"
    assert coverage(space.variable(result.bases)[:, space.reducible]) == result.coverage


@settings(max_examples=examples(60), deadline=None)
@given(st.integers(1, 6).flatmap(lambda n: st.lists(st.lists(st.booleans(), min_size=n, max_size=n), min_size=1, max_size=40)))
def test_what_is_kept_covers_what_all_did(rows: list[list[bool]]) -> None:
    masks = np.array([row for row in rows if any(row)] or [[True] * len(rows[0])])
    assert coverage(masks[_kept(masks, len(masks))]) == coverage(masks)
    assert len(_kept(masks, 3)) == min(3, len(masks))


def test_combinations_that_the_samples_cannot_hold_are_told_as_missing() -> None:
    single = np.eye(6, dtype=np.bool_)
    masks = np.vstack([single, single[:1] | single[1:2]])
    kept = masks[_kept(masks, 3)]
    assert sorted(kept.sum(axis=1)) == [1, 1, 2]
    assert coverage(kept).covered == coverage(masks).covered - 2


def test_the_cap_is_kept_and_what_is_missing_is_told() -> None:
    result = present(design(classified([LOW] * 10), 8, 1, 1, 20))
    assert result.drawn == 20
    assert result.coverage.covered < result.coverage.effects == 1023


def test_differences_without_a_score_count_for_no_base() -> None:
    missing = np.nan
    differences = Differences(np.array([[0.0, 2.0, -1.0, -7.0], [missing, missing, 3.0, 0.0], [missing] * 4]))
    assert sorted(differences.known.tolist()) == [-7, -1, 0, 0, 2, 3]
    assert differences.wrong_shares(1).tolist() == [0.5, 0.5]
    assert Differences(np.full((2, 3), missing)).wrong_shares(1).size == 0


@pytest.mark.parametrize("seed", [1, 2, 2**63 - 1])
def test_the_sets_are_others_than_those_of_a_start_population_with_the_same_seed(seed: int) -> None:
    """A hypercube of the search's own start would find its answers there, and test nothing new."""
    searched = [np.arange(100)] * 3 + [np.zeros(100, dtype=np.int64)]
    drawn = present(design(classified(searched), 50, 2, seed, 50))
    settings = GeneticSettings(population=50, seed=seed)
    start = GENETIC.create(settings, np.full(4, 100)).ask().population
    assert not {tuple(base) for base in drawn.bases.tolist()} & {tuple(individual) for individual in start.tolist()}


def test_under_constraints_as_many_sets_are_compared_as_without() -> None:
    """One of 40,320 curves rises by chance."""
    names = [f"c{number}" for number in range(8)]
    space = ParameterSpace(tuple(Parameter.integer(name, Decimal(0), Decimal(9)) for name in names))
    rising = Constraints(space, {text: Constraint(text) for text in (f"{a} <= {b}" for a, b in pairwise(names))})
    reducible = classified([LOW] * 8)
    drawn = present(design(reducible, 40, 5, 1, 40, rising))
    assert len(drawn.bases) > 30
    together = np.concatenate([drawn.bases[:, None], drawn.variants], axis=1)
    assert rising.feasible(drawn.bases).all()
    assert rising.feasible(together.reshape(-1, 8)).mean() > 0.95
    assert (LOW[drawn.bases[:, None]] == LOW[drawn.variants]).all(), "variants stay in their regions"


SEEDS = (0, 1, 2, 2**32, 2**63 - 1)


def first(drawing: np.random.Generator) -> int:
    return int(drawing.integers(2**63))


def test_no_two_streams_begin_alike() -> None:
    keyed = [first(generator(name, seed, *key)) for name, seed, key in product(("a", "b"), SEEDS, ((), (0,), (1,), (0, 0)))]
    plain = [first(np.random.Generator(np.random.PCG64(seed))) for seed in SEEDS]
    assert len({*keyed, *plain}) == len(keyed) + len(plain)
    assert first(generator("a", 1, 0)) == keyed[5]

"""Table 5 over seeds, and pairs of runs that differ in their reduction alone."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.analysis.comparison import Conditions, Course, best_of_all, effects, groups, labels, pairs, succeeds


def course(
    best: Sequence[float | None],
    optimizer: str = "genetic",
    seed: int = 1,
    reduction: str = "exact",
    simulations: int = 10,
    *,
    ended: bool = True,
) -> Course:
    """A run that simulated the same number in every iteration."""
    return Course(
        f"{optimizer}-{seed}-{reduction}",
        Conditions(optimizer, 50, seed, reduction),
        best=best,
        ratings=[None if item is None else item + 0.25 for item in best],
        alternatives=list(range(1, len(best) + 1)),
        means=best,
        simulations=[simulations] * len(best),
        ended=ended,
    )


def test_a_group_sums_its_seeds_up_and_counts_convergence_as_table_5_does() -> None:
    settled = course([3.0, 3.0, *[4.0] * 11], seed=1)  # best in the third iteration, then ten further ones
    restless = course([3.0] * 12 + [5.0], seed=2, simulations=20)
    (group,) = groups([settled, restless])
    assert (group.seeds, group.best, group.mean, group.minimum) == (2, 5.0, 4.5, 4.0)
    assert group.rating == 4.75
    assert group.alternatives == 13
    assert group.simulations == (130 + 260) / 2
    assert (group.converged, group.iterations_to_converge, group.simulations_to_converge) == (1, 3.0, 30.0)
    assert group.successes == 1
    assert settled.alternatives_converged_at is None


def test_runs_without_a_result_count_as_seeds_and_nothing_else() -> None:
    (group,) = groups([course([], seed=1), course([None, None], seed=2), course([None, 2.0], seed=3)])
    assert (group.seeds, group.best, group.mean, group.minimum, group.successes) == (3, 2.0, 2.0, 2.0, 1)
    (empty,) = groups([course([])])
    assert (empty.best, empty.mean, empty.rating, empty.simulations, empty.successes) == (None, None, None, None, 0)


def test_success_is_judged_over_all_optimizers_with_rounding_errors_forgiven() -> None:
    runs = [course([6.0]), course([6.0 - 1e-15], "swarm"), course([5.9], "random")]
    best = best_of_all(runs)
    assert best == 6.0
    assert [succeeds(run, best) for run in runs] == [True, True, False]
    assert best_of_all([course([])]) is None
    assert not succeeds(runs[0], None)


def test_only_runs_that_went_to_their_end_are_paired_and_only_with_their_own_seed() -> None:
    runs = [
        *(course([4.0], seed=seed) for seed in (1, 2, 3)),
        course([4.5], seed=1, reduction="influence", simulations=4),
        course([4.0], seed=2, reduction="influence", ended=False),
        course([None], seed=3, reduction="influence"),
        course([4.0], "swarm", seed=1, reduction="influence"),
    ]
    (pair,) = pairs(runs)
    assert (pair.run.conditions.seed, pair.difference, pair.saved) == (1, 0.5, 6)
    assert pairs([]) == []
    assert effects([]) == []


def paired(differences: Sequence[float], optimizer: str = "genetic") -> list[Course]:
    without = [course([4.0], optimizer, seed) for seed in range(len(differences))]
    reduced = [course([4.0 + one], optimizer, seed, "influence", simulations=7) for seed, one in enumerate(differences)]
    return [*without, *reduced]


def test_an_effect_gives_students_interval_the_sign_test_and_what_was_saved() -> None:
    (effect,) = effects(pairs(paired([0.5, -0.25, 0.5, 0.0, 0.5])))
    assert (effect.pairs, effect.better, effect.equal, effect.worse) == (5, 3, 1, 1)
    assert effect.mean_difference == 0.25
    # standard deviation 0.3535533906 over sqrt(5), Student's quantile 2.7764451052 with 4 degrees of freedom
    assert effect.upper_95 == pytest.approx(0.25 + 2.7764451052 * 0.3535533906 / 5**0.5)
    assert effect.lower_95 == pytest.approx(0.5 - (effect.upper_95 or 0))
    assert effect.sign_test == pytest.approx(2 * (4 + 1) / 2**4)  # 3 or 4 of 4, both sides
    assert (effect.simulations, effect.base_simulations, effect.saved_share) == (35, 50, 0.3)


def test_searches_that_all_end_alike_bound_how_many_may_not() -> None:
    (effect,) = effects(pairs(paired([0.0] * 10)))
    assert (effect.mean_difference, effect.lower_95, effect.upper_95, effect.sign_test) == (0.0, None, None, 1.0)
    assert effect.different_upper_95 == pytest.approx(1 - 0.025 ** (1 / 10))
    (rounded,) = effects(pairs(paired([1e-15, 0.0])))
    assert (rounded.mean_difference, rounded.equal) == (0.0, 2)
    (single,) = effects(pairs(paired([0.0])))
    assert (single.lower_95, single.upper_95) == (None, None)


def test_several_conditions_are_summed_up_over_all_of_them() -> None:
    result = effects(pairs([*paired([0.5, 0.5]), *paired([-0.5, -0.5], "swarm")]))
    assert [(item.optimizer, item.mean_difference) for item in result] == [("genetic", 0.5), ("swarm", -0.5), (None, 0.0)]
    assert (result[2].population, result[2].pairs, result[2].sign_test) == (None, 4, 1.0)


@given(st.lists(st.sampled_from([-0.5, 0.0, 0.25]), min_size=1, max_size=12))
def test_the_interval_holds_the_mean_and_signs_add_up(differences: list[float]) -> None:
    (effect,) = effects(pairs(paired(differences)))
    assert effect.better + effect.equal + effect.worse == effect.pairs == len(differences)
    assert (effect.lower_95 is None) == (len(set(differences)) == 1)
    if effect.lower_95 is not None and effect.upper_95 is not None:
        assert effect.lower_95 <= effect.mean_difference <= effect.upper_95
    assert 0 < effect.sign_test <= 1
    assert effect.different_upper_95 >= (effect.better + effect.worse) / effect.pairs


def test_the_optimum_is_what_was_confirmed_and_what_that_took_counts() -> None:
    base = course([6.0, 6.5])
    confirmed = replace(
        course([6.0, 7.0], reduction="influence", simulations=6), reused=True, simulated_best=6.25, confirmations=3
    )
    (pair,) = pairs([base, confirmed])
    assert pair.difference == -0.25
    assert pair.saved == 20 - 15
    (effect,) = effects([pair])
    assert (effect.simulations, effect.base_simulations) == (15, 20)
    assert groups([confirmed])[0].simulations == 15
    assert confirmed.simulations_to_converge is None
    rounded = replace(confirmed, simulated_best=7.0 - 1e-15)
    assert rounded.optimum == 7.0, "what differs by rounding alone is no other belief"


def test_the_lowest_optimum_is_the_best_on_a_scale_that_is_minimised() -> None:
    runs = [course([5.0, 4.0], seed=1), course([5.0, 4.0 + 1e-15], seed=2), course([9.0, 8.5], seed=3)]
    best = best_of_all(runs, sign=-1)
    assert best == 4.0
    assert [succeeds(run, best, sign=-1) for run in runs] == [True, True, False]
    (group,) = groups(runs, sign=-1)
    assert (group.best, group.successes) == (4.0, 2)
    (effect,) = effects(pairs(paired([0.5, -0.25, 0.5, 0.0, 0.5])), sign=-1)
    assert (effect.better, effect.equal, effect.worse) == (1, 1, 3)


def test_labels_name_the_settings_in_which_equal_kinds_differ() -> None:
    settings: list[dict[str, Any]] = [
        {"kind": "genetic", "mutation": 0.2, "start": "lhs"},
        {"kind": "swarm"},
        {"kind": "genetic", "start": "lhs"},
    ]
    assert labels(settings, "kind") == ["genetic mutation=0.2", "swarm", "genetic"]
    assert labels([*settings, {"kind": "genetic", "mutation": 0.5, "start": "lhs"}], "kind") == [
        *("genetic mutation=0.2", "swarm", "genetic", "genetic mutation=0.5")
    ]


def test_a_course_has_the_first_the_better_and_the_last_iteration() -> None:
    run = course([None, 3.0, 3.0, 4.0, 4.0, 4.0])
    assert [(step.iteration, step.simulations, step.best) for step in run.improvements] == [
        (2, 20, 3.0),
        (4, 40, 4.0),
        (6, 60, 4.0),
    ]


def test_optimizers_are_compared_at_equal_simulations() -> None:
    quick, slow = groups([course([1.0, 2.0, 4.0, 4.0]), course([None, 1.0], "swarm", simulations=20)])
    assert quick.after == {10: 1.0, 20: 2.0, 40: 4.0}
    assert slow.after == {10: None, 20: None, 40: 1.0}

"""Table 5 over seeds."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from drivecal.analysis.comparison import Conditions, Course, best_of, groups, labels, succeeds
from drivecal.analysis.convergence import alternatives_at, best_at
from drivecal.contracts.tables import Generation


def course(
    best: Sequence[float | None], optimizer: str = "genetic", seed: int = 1, reduction: str = "exact", simulations: int = 10
) -> Course:
    """A run that simulated the same number in every iteration."""
    iterations = [
        Generation(
            iteration=place,
            requested=simulations,
            simulated=simulations,
            best=each,
            rating=None if each is None else each + 0.25,
            mean=each,
            alternatives=place + 1,
        )
        for place, each in enumerate(best)
    ]
    return Course(f"{optimizer}-{seed}-{reduction}", Conditions(optimizer, 50, seed, reduction), iterations)


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


def test_runs_without_a_result_count_as_seeds_and_nothing_else() -> None:
    (group,) = groups([course([], seed=1), course([None, None], seed=2), course([None, 2.0], seed=3)])
    assert (group.seeds, group.best, group.mean, group.minimum, group.successes) == (3, 2.0, 2.0, 2.0, 1)
    (empty,) = groups([course([])])
    assert (empty.best, empty.mean, empty.rating, empty.simulations, empty.successes) == (None, None, None, None, 0)


def test_success_is_judged_over_all_optimizers_with_rounding_errors_forgiven() -> None:
    runs = [course([6.0]), course([6.0 - 1e-15], "swarm"), course([5.9], "random")]
    best = best_of(run.optimum for run in runs)
    assert best == 6.0
    assert [succeeds(run, best) for run in runs] == [True, True, False]
    assert best_of([course([]).optimum]) is None
    assert not succeeds(runs[0], None)


def test_the_optimum_is_what_was_confirmed_and_what_that_took_counts() -> None:
    run = course([6.0, 7.0], reduction="influence", simulations=6)
    copied = [each.model_copy(update={"requested": 7, "reused": 1}) for each in run.iterations]
    confirmed = replace(run, iterations=copied, surest=6.25, confirmations=3)
    assert confirmed.optimum == 6.25
    assert groups([confirmed])[0].simulations == 15
    assert confirmed.simulations_to_converge is None
    rounded = replace(confirmed, surest=7.0 - 1e-15)
    assert rounded.optimum == 7.0, "what differs by rounding alone is no other belief"


def test_the_lowest_optimum_is_the_best_on_a_scale_that_is_minimised() -> None:
    runs = [course([5.0, 4.0], seed=1), course([5.0, 4.0 + 1e-15], seed=2), course([9.0, 8.5], seed=3)]
    best = best_of((run.optimum for run in runs), sign=-1)
    assert best == 4.0
    assert [succeeds(run, best, sign=-1) for run in runs] == [True, True, False]
    (group,) = groups(runs, sign=-1)
    assert (group.best, group.successes) == (4.0, 2)


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


def test_the_best_has_converged_where_it_was_found_if_it_then_stays_for_ten_iterations() -> None:
    assert best_at([2.0, 3.0, 3.0, 5.0] + 10 * [5.0]) == 4
    assert best_at([2.0, 3.0, 3.0, 5.0] + 9 * [5.0]) is None
    assert best_at(11 * [4.0]) == 1


def test_the_number_of_alternatives_has_to_stay_for_more_than_five() -> None:
    assert alternatives_at(8 * [7.0], [1, 4, 11] + 5 * [11]) is None
    assert alternatives_at(9 * [7.0], [1, 4, 11] + 6 * [11]) == 3


def test_an_iteration_without_any_result_is_no_best() -> None:
    assert best_at(12 * [None]) is None
    assert best_at([None, *(11 * [3.0])]) == 2


def test_alternatives_of_another_best_objective_are_others() -> None:
    """Each iteration has one set that is better than all before."""
    assert alternatives_at([5.0 + place / 6 for place in range(8)], [1] * 8) is None
    assert alternatives_at([5.0] + [6.0] * 7, [1] * 8) == 2
    assert alternatives_at([None] * 8, [0] * 8) is None


def test_random_campaigns_are_compared_by_what_they_report() -> None:
    lucky = [replace(course([9.0, 9.5], seed=seed), surest=6.0 + seed, is_random=True) for seed in (1, 2)]
    (group,) = groups(lucky)
    assert (group.best, group.minimum, group.successes) == (8.0, 7.0, None)
    assert not group.after

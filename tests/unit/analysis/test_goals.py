"""Objectives and constraints of a set, the front of a ranking, and the aims of searches that ask for single cells."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.values import present

from drivecal.analysis.aims import JudgedGoals, WeightedScore
from drivecal.analysis.confirmation import Confirming, front_outcome
from drivecal.analysis.goals import Aggregate, Bound, CellValue, Goals, Objective
from drivecal.analysis.solutions import Ranking
from drivecal.domain.evaluations import CellScore
from drivecal.domain.scales import COMFORT, Direction, Scale

EVEN = {"S1": 0.5, "S2": 0.5}
MEAN = Aggregate()
COMFORTABLE = Objective("comfort", CellValue(COMFORT), EVEN, MEAN, 1)
GAP = Objective("gap", CellValue(measure="gap_m", failed=0.0), EVEN, Aggregate("min"), 1)
COST = CellValue(Scale("cost", Direction.MINIMISE, 0, 100, 0, 100), formula="10*energy")
ENOUGH = Bound("gap", GAP.value, EVEN, Aggregate("min"), 1, 5.0, 5.0)


def cell(number: int, scenario: str, score: float | None, gap: float | None = None, *, own: bool = True) -> CellScore:
    values = {} if gap is None else {GAP.value.key: gap}
    return CellScore(number, scenario, score, score, own, iteration=number, individual=0, values=values)


def ranked(goals: Goals, *sets: tuple[float, float], own: bool = True) -> Ranking:
    """A ranking of sets with a score and a gap, the same in both scenarios."""
    ranking = Ranking(EVEN, goals=goals)
    ranking.add(cell(number, name, score, gap, own=own) for number, (score, gap) in enumerate(sets, 1) for name in EVEN)
    return ranking


def numbers(ranking: Ranking) -> list[tuple[int, int]]:
    return [(member.solution.parameter_set, member.alternatives) for member in ranking.front()]


@pytest.mark.parametrize(
    ("aggregate", "expected"),
    [
        (Aggregate(), 2.25),
        (Aggregate("min"), 1.0),
        (Aggregate("max"), 5.0),
        (Aggregate("quantile", 0.0), 1.0),
        (Aggregate("quantile", 0.5), 1.0),
        (Aggregate("quantile", 0.51), 2.0),
        (Aggregate("quantile", 1.0), 5.0),
    ],
)
def test_values_of_scenarios_are_aggregated_with_their_weights(aggregate: Aggregate, expected: float) -> None:
    assert aggregate(np.array([[5.0, 1.0, 2.0]]), [0.25, 0.5, 0.25]) == [expected]


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=9), st.floats(0, 1))
def test_a_quantile_is_one_of_the_values_and_grows_with_its_level(values: list[float], level: float) -> None:
    shares = [1 / len(values)] * len(values)
    quantile, most = (Aggregate("quantile", each)(np.array([values]), shares) for each in (level, 1.0))
    assert min(values) <= quantile <= most == max(values)
    assert quantile in values


def test_values_of_runs_are_scores_measures_and_the_worth_of_failed_runs() -> None:
    assert COST.of({"energy": 3.0}, None) == 30.0
    assert COST.of({"energy": 3.0}, "collision") == 100.0
    assert COST.of({}, None) is None
    assert GAP.value.of({"gap_m": 3.0}, None) == 3.0
    assert GAP.value.of({"gap_m": None}, None) is None
    assert GAP.value.of({"gap_m": 3.0}, "collision") == 0.0
    assert CellValue(measure="gap_m").of({"gap_m": 3.0}, "collision") is None


def test_constraints_of_one_name_are_told_apart() -> None:
    goals = Goals((COMFORTABLE,), (ENOUGH, replace(ENOUGH, sign=-1, limit=50.0), replace(ENOUGH, name="gap 2")))
    cells = {name: cell(1, name, 6.0, gap) for name, gap in (("S1", 4.0), ("S2", 60.0))}
    judged = present(next(goals.judge([cells])))
    assert goals.named_bounds(judged) == {"gap": 4.0, "gap 2": 4.0, "gap 2 2": 4.0}
    assert judged.violation == pytest.approx(2 * (5.0 - 4.0) / 5.0)


def test_values_of_equal_names_are_told_apart_and_equal_values_named_once() -> None:
    other = CellValue(measure="gap_m", failed=9.0)
    goals = Goals((COMFORTABLE, GAP), (ENOUGH, replace(ENOUGH, value=other)))
    cells = {
        name: replace(cell(1, name, 6.0, gap), values={GAP.value.key: gap, other.key: gap + 1})
        for name, gap in (("S1", 4.0), ("S2", 5.0))
    }
    assert goals.named_values(cells) == {"gap@S1": 4.0, "gap@S2": 5.0, "gap 2@S1": 5.0, "gap 2@S2": 6.0}
    assert goals.value_names == list(goals.named_values(cells))


def test_a_copied_score_that_only_a_constraint_needs_is_named() -> None:
    bound = Bound("comfort", CellValue(COMFORT), {"S2": 1.0}, MEAN, 1, 5.0, 7.0)
    goals = Goals((replace(COMFORTABLE, shares={"S1": 1.0}),), (bound,))
    ranking = Ranking({"S1": 1.0, "S2": 0.0}, goals=goals)
    ranking.add([cell(1, "S1", 6.0), cell(1, "S2", 4.0, own=False)])
    (ranked_set,) = ranking.best_first()
    assert (ranked_set.reused, ranked_set.objective) == (("S2",), 6.0)
    assert ranked_set.violation == pytest.approx(1 / 7)


def test_goals_are_the_same_after_they_were_stored() -> None:
    goals = Goals((COMFORTABLE, GAP, Objective("cost", COST, EVEN, Aggregate("quantile", 0.1), -1, 0.5)), (ENOUGH,))
    assert Goals.from_json(json.loads(json.dumps(goals.to_json()))) == goals
    assert sorted(goals.computed) == sorted([GAP.value.key, COST.key])


def test_the_front_lists_each_vector_once_best_first_objective_first() -> None:
    ranking = ranked(Goals((COMFORTABLE, GAP)), (3.0, 9.0), (6.0, 2.0), (3.0, 9.0), (5.0, 1.0), (5.0, 5.0))
    assert numbers(ranking) == [(2, 1), (5, 1), (1, 2)]
    best = present(ranking.best())
    assert (best[0].parameter_set, best[0].objective) == (2, 6.0)


def test_differences_up_to_the_tolerance_do_not_count() -> None:
    coarse = Objective("gap", GAP.value, EVEN, Aggregate("min"), 1, tolerance=2.0)
    ranking = ranked(Goals((COMFORTABLE, coarse)), (3.0, 9.0), (6.0, 8.2))
    assert numbers(ranking) == [(2, 1)]


def test_a_set_that_keeps_the_constraints_is_better_than_every_set_that_does_not() -> None:
    goals = Goals((COMFORTABLE,), (ENOUGH,))
    ranking = ranked(goals, (7.0, 2.0), (6.0, 4.0))
    assert numbers(ranking) == [(2, 1)], "less is missing"
    ranking.add(cell(3, name, 1.0, 5.0) for name in EVEN)
    best = present(ranking.best())
    assert (best[0].parameter_set, best[1]) == (3, 1)
    assert [solution.parameter_set for solution in ranking.best_first()] == [3, 2, 1]


def test_a_set_that_lacks_a_value_has_no_place() -> None:
    ranking = Ranking(EVEN, goals=Goals((COMFORTABLE, GAP)))
    ranking.add([cell(1, "S1", 5.0, 2.0), cell(1, "S2", 5.0), cell(2, "S1", 5.0, 2.0), cell(2, "S2", None, 2.0)])
    assert not ranking.front()
    assert not ranking.best_first()


def test_copied_sets_that_would_be_on_the_front_are_confirmed_until_none_is_left() -> None:
    ranking = ranked(Goals((COMFORTABLE, GAP)), (3.0, 9.0), (5.0, 5.0))
    ranking.add(cell(number, name, 6.0, gap, own=False) for number, gap in ((7, 7.0), (8, 1.0)) for name in EVEN)
    confirmation = Confirming(5, 6.0)
    chosen = present(confirmation.choose(ranking))
    assert (chosen.parameter_set, chosen.reused) == (7, ("S1", "S2"))
    assert front_outcome(ranking.front(), [7]).state == "unconfirmed"
    ranking.add(cell(7, name, 4.0, 4.0) for name in EVEN)
    confirmation.tried.append(7)
    second = present(confirmation.choose(ranking))
    assert second.parameter_set == 8
    ranking.add(cell(8, name, 6.0, 0.5) for name in EVEN)
    confirmation.tried.append(8)
    assert confirmation.choose(ranking) is None
    assert front_outcome(ranking.front(), confirmation.tried).state == "confirmed"
    assert numbers(ranking) == [(8, 1), (2, 1), (1, 1)]


def test_a_set_reaches_the_front_unless_a_sure_set_is_as_good_in_everything() -> None:
    ranking = ranked(Goals((COMFORTABLE, GAP)), (3.0, 9.0), (6.0, 2.0))
    ranking.add(cell(9, name, 7.0, 10.0, own=False) for name in EVEN)
    reaches = [
        ranking.reaches_front({name: cell(4, name, *values) for name in EVEN})
        for values in ((3.0, 9.0), (5.0, 2.0), (5.0, 3.0))
    ]
    assert reaches == [False, False, True]


def test_the_best_set_is_doubtful_if_it_is_a_copy_of_equal_objectives_that_ranks_before_a_set_of_its_own_scores() -> None:
    ranking = Ranking(EVEN, goals=Goals((COMFORTABLE, GAP)))
    ranking.add(
        replace(cell(number, name, 3.0, 5.0, own=own), rating=rating)
        for number, rating, own in [(1, 3.2, True), (2, 3.4, False)]
        for name in EVEN
    )
    best = present(ranking.best())
    assert best[0].parameter_set == 2
    assert numbers(ranking) == [(1, 2)]
    doubtful = present(ranking.doubtful())
    assert doubtful.parameter_set == 2
    assert ranking.doubtful({2}) is None
    ranking.add(cell(2, name, 2.0, 5.0) for name in EVEN)
    assert ranking.doubtful({2}) is None
    best = present(ranking.best())
    assert best[0].parameter_set == 1


SCALE = Scale("points", Direction.MAXIMISE, 0.0, 7.0, 1.0, 0.0)
SHARES = st.just({"S0": 0.5, "S1": 0.2, "S2": 0.3})
VALUES, SIGNS = st.sampled_from([CellValue(measure="a"), CellValue(measure="b")]), st.sampled_from([1, -1])
AGGREGATES = st.builds(Aggregate, st.sampled_from(["mean", "min", "max", "quantile"]), st.floats(0, 1))
VARIANTS = st.sampled_from([(), ({"S0": 0.4, "S1": 0.6}, {"S2": 1.0}, {"S0": 0.1, "S2": 0.9})])
OBJECTIVES = st.builds(Objective, st.just("a"), VALUES, SHARES, AGGREGATES, SIGNS, variants=VARIANTS, worst=st.booleans())
BOUNDS = st.builds(Bound, st.just("b"), VALUES, SHARES, AGGREGATES, SIGNS, st.integers(-2, 2), st.just(3.0))
NUMBERS = st.one_of(st.integers(-2, 2).map(float), st.floats(-1e3, 1e3))
CELLS = st.dictionaries(VALUES.map(lambda value: value.key), NUMBERS, min_size=1).map(
    lambda values: CellScore(1, "S", 1.0, 1.0, True, 0, 0, values=values)
)
SETS = st.lists(st.fixed_dictionaries(dict.fromkeys(("S0", "S1", "S2"), CELLS)), min_size=1, max_size=5)


@given(SETS, st.builds(Goals, st.tuples(OBJECTIVES, OBJECTIVES), st.tuples(BOUNDS, BOUNDS)))
def test_goals_are_judged_by_arrays_as_by_cells(sets: list[dict[str, CellScore]], goals: Goals) -> None:
    aim = JudgedGoals(goals, ("S0", "S1", "S2"))
    table = np.array([[aim.of(cells[name]) for name in aim.names] for cells in sets])
    for amounts, violation, judged in zip(*aim.judge(table), goals.judge(sets), strict=True):
        known = None if judged is None else (*goals.compared(judged), judged.violation)
        assert known == (None if np.isnan([*amounts, violation]).any() else (*amounts, violation))


def test_a_sound_run_with_the_worst_score_is_no_failure_for_goals_of_its_measures() -> None:
    goals = JudgedGoals(Goals((Objective("a", CellValue(measure="a"), {"S": 1.0}, Aggregate(), -1),)), ("S",))
    runs = [
        CellScore(1, "S", score, score, True, 0, 0, failed=failed)
        for score, failed in ((5.0, False), (0.0, False), (0.0, True))
    ]
    runs.append(CellScore(1, "S", None, None, True, 0, 0))
    assert [goals.is_failure(run) for run in runs] == [False, False, True, True]
    assert [WeightedScore({"S": 1.0}, SCALE).is_failure(run) for run in runs] == [False, True, True, True]

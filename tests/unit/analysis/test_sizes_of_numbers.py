"""Numbers of any size and offset are ranked, compared and learned from as the same numbers between 0 and 1 are."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples
from tests.support.values import present

from drivecal.analysis.aims import JudgedGoals
from drivecal.analysis.convergence import changes, converged_at, improved_last, last_change, stood_still
from drivecal.analysis.front import knee, winning_weights
from drivecal.analysis.goals import Aggregate, Bound, CellValue, Goals, Objective
from drivecal.analysis.importance import importances
from drivecal.analysis.robustness import deviation, holds
from drivecal.analysis.solutions import Ranking
from drivecal.contracts.specification import RobustnessSpecification
from drivecal.contracts.tables import Generation
from drivecal.domain.evaluations import CellScore
from drivecal.domain.scales import Direction, Scale
from drivecal.optimizers.population import ranking
from drivecal.optimizers.surrogate.gaussian_process import Points
from drivecal.optimizers.surrogate.merits import Standing
from drivecal.optimizers.surrogate.models import ScenarioModel
from drivecal.plugins.ports import Floats
from drivecal.reduction.forest import Forest, RegressionForest
from drivecal.reduction.prediction import ScenarioLearner

WEIGHTS = {"S1": 0.6, "S2": 0.4}
SIZES = st.sampled_from(
    [(1e-12, 0.0), (1e-12, 1e-9), (1e-7, 1.0), (1e-3, 1e5), (1.0, 1e9), (1.0, -1e9), (1e12, 0.0), (1e12, 1e15)]
)
THOUSANDTHS = st.integers(0, 1000)
FIRST, SECOND = CellValue(measure="first"), CellValue(measure="second")


def goals(size: float, offset: float, *, tolerance: float = 0.0, limit: float | None = None) -> Goals:
    """Two measures that are maximised; the second one is at least the limit."""
    pair = [Objective(value.measure or "", value, WEIGHTS, Aggregate(), 1, size * tolerance) for value in (FIRST, SECOND)]
    bounds = () if limit is None else (Bound("second", SECOND, WEIGHTS, Aggregate("min"), 1, size * limit + offset, size),)
    return Goals(tuple(pair), bounds)


def ranked(rows: list[tuple[int, int, int]], size: float, offset: float, aims: Goals) -> Ranking:
    """Returns the ranking of sets with these thousandths in the first and the second scenario, and of the second measure."""
    standing = Ranking(WEIGHTS, aims)
    for number, (first, other, second) in enumerate(rows):
        for scenario, value in (("S1", first), ("S2", other)):
            values = {FIRST.key: size * value / 1000 + offset, SECOND.key: size * second / 1000 + offset}
            standing.add([CellScore(number, scenario, 1.0, 1.0, True, number, 0, values=values)])
    return standing


@pytest.mark.slow
@given(
    rows=st.lists(st.tuples(THOUSANDTHS, THOUSANDTHS, THOUSANDTHS), min_size=2, max_size=30),
    size=SIZES,
    tolerance=st.sampled_from([0.0, 0.0505]),
    limit=st.sampled_from([None, 0.0, 0.5]),
)
@settings(max_examples=examples(150), deadline=None)
def test_ranks_fronts_and_constraints_do_not_depend_on_the_unit(
    rows: list[tuple[int, int, int]], size: tuple[float, float], tolerance: float, limit: float | None
) -> None:
    usual, other = (ranked(rows, *each, goals(*each, tolerance=tolerance, limit=limit)) for each in ((1.0, 0.0), size))
    assert [each.parameter_set for each in usual.best_first()] == [each.parameter_set for each in other.best_first()]
    assert [each.violation > 0 for each in usual.best_first()] == [each.violation > 0 for each in other.best_first()]
    first, same = usual.best(), other.best()
    assert present(first)[1] == present(same)[1]
    fronts = [[(member.solution.parameter_set, member.alike) for member in each.front()] for each in (usual, other)]
    assert fronts[0] == fronts[1]
    assert fronts[0], "a front is never empty"
    both = ((1.0, 0.0), usual), (size, other)
    points = [goals(*each).signed(member.solution.judgement for member in standing.front()) for each, standing in both]
    assert knee(points[0]) == knee(points[1]) or len(points[0]) < 4
    wins = [[each.share for each in winning_weights(listed) or ()] for listed in points]
    assert wins[1] == pytest.approx(wins[0], abs=1e-4)


@given(rows=st.lists(st.tuples(THOUSANDTHS, THOUSANDTHS), min_size=2, max_size=30))
@settings(max_examples=examples(100), deadline=None)
def test_a_set_leaves_the_front_only_for_one_better_by_more_than_the_tolerance(rows: list[tuple[int, int]]) -> None:
    standing = ranked([(first, first, second) for first, second in rows], 1.0, 0.0, goals(1.0, 0.0, tolerance=0.0505))
    on_front = {number for member in standing.front() for number in member.alike}

    def beats(better: tuple[int, int], other: tuple[int, int]) -> bool:
        gains = [mine - theirs for mine, theirs in zip(better, other, strict=True)]
        return min(gains) >= -50 and max(gains) > 50

    assert on_front == {number for number, row in enumerate(rows) if not any(beats(each, row) for each in rows)}


@given(values=st.lists(THOUSANDTHS, min_size=1, max_size=30), size=SIZES)
def test_courses_populations_and_conditions_do_not_depend_on_the_unit(values: list[int], size: tuple[float, float]) -> None:
    usual = np.array(values) / 1000
    other = size[0] * usual + size[1]
    assert ranking(usual, -usual).tolist() == ranking(other, -other).tolist()
    courses = [np.maximum.accumulate(each).tolist() for each in (usual, other)]
    for summary in (last_change, lambda each: converged_at(each, 3), lambda each: changes(each, [1] * len(each))):
        assert summary(courses[0]) == summary(courses[1])
    points = [[Generation(iteration=0, best=best, rating=best, alternatives=1) for best in each] for each in courses]
    assert improved_last(points[0]) == improved_last(points[1])
    assert stood_still(points[0], courses[0][-1]) == stood_still(points[1], courses[1][-1])
    shares = [(usual, 1.0), (other, size[0])]
    kept = [
        holds(deviation(each[:1], each[:, np.newaxis], "max"), each[:1], RobustnessSpecification(eta=0.1 * unit))
        for each, unit in shares
    ]
    assert kept[0] == kept[1]
    scales = [Scale("s", Direction.MAXIMISE, offset, unit + offset, 0.1 * unit, offset) for unit, offset in ((1.0, 0.0), size)]
    assert [scales[0].is_wrong(each - usual[0]) for each in usual] == [scales[1].is_wrong(each - other[0]) for each in other]
    beaten = [Standing(row[:, np.newaxis], 0.0 * row).beats(row[:, np.newaxis], 0.0 * row).tolist() for row in (usual, other)]
    assert beaten[0] == beaten[1]


def test_huge_measures_and_cancelling_sums_do_not_break_a_ranking() -> None:
    aims = goals(1.0, 0.0, limit=5.0)
    standing = ranked([(1, 2, 3), (3, 2, 1)], 1e306, 0.0, aims)
    assert len(standing.best_first()) == 2
    assert FIRST.of({"first": 1.797e308}, None) == 1e15
    assert replace(FIRST, failed=-1e300).of({}, "collision") == -1e15


LEARNED = [(1e-10, 0.0), (1e-3, 1e5), (1.0, 1e9), (1e12, 0.0)]


def learned(offset: float = 0.0, size: float = 1.0) -> tuple[Floats, Floats]:
    features = np.random.default_rng(0).integers(0, 101, (300, 2)) / 100
    return features, size * (7 * features[:, 0] + 7 * features[:, 1] ** 2) + offset


@pytest.mark.parametrize(("size", "offset"), LEARNED)
def test_importances_do_not_depend_on_the_unit(size: float, offset: float) -> None:
    usual = importances(*learned())
    other = present(importances(np.array([1e-7, 0.01]) * learned()[0] + np.array([0.0, 1e5]), learned(offset, size)[1]))
    assert other.mean == pytest.approx(present(usual).mean, abs=0.02)
    assert other.r2 == pytest.approx(present(usual).r2, abs=0.01)


@pytest.mark.parametrize(("size", "offset"), LEARNED)
@pytest.mark.parametrize("kind", [Forest, RegressionForest])
def test_predictions_do_not_depend_on_the_unit(size: float, offset: float, kind: type[Forest | RegressionForest]) -> None:
    features, usual = learned()
    usual = np.round(usual)
    other, answers = size * usual + offset, []
    for scores, unit in ((usual, 1.0), (other, size)):
        learner = ScenarioLearner(partial(kind, unit), unit)
        learner.learn(features[:200], scores[:200], scores[:200])
        predicted = present(learner.predict(features[200:]))
        told = predicted[0].scores, predicted[0].confidence, predicted[0].variance / unit**2, predicted[1]
        answers.append((*told, learner.is_wrong(scores[:-1], scores[1:])))
    (scores, *rest), (same, *same_rest) = answers
    assert (same - offset) / size == pytest.approx(scores, abs=1e-6)
    for usual_answer, other_answer in zip(rest, same_rest, strict=True):
        assert other_answer == pytest.approx(usual_answer, abs=1e-6)


@pytest.mark.parametrize(("size", "offset"), LEARNED)
def test_models_of_the_surrogate_do_not_depend_on_the_unit(size: float, offset: float) -> None:
    features, usual = learned()
    beliefs = []
    for unit, away in ((1.0, 0.0), (size, offset)):
        value = CellValue(measure="m")
        aim = JudgedGoals(Goals((Objective("m", value, {"s": 1.0}, Aggregate(), -1),)), ("s",))
        model = ScenarioModel(1, 2, np.arange(2), aim.best[0], aim.worst[0])
        points = Points(features, np.ones(len(features), dtype=np.int64))
        values = (unit * np.exp(usual[:60] / 4) + away)[:, np.newaxis]
        model.learn(points[:60], values, np.zeros(60, dtype=np.bool_), points[:0])
        belief = model.predict(features[60:90], pending=True)
        drawn = model.values(belief, np.full((1, 1, 1), 0.5), np.full((1, 1), 0.9))
        beliefs.append((drawn - away) / unit)
    assert beliefs[1] == pytest.approx(beliefs[0], rel=0.01, abs=0.01)

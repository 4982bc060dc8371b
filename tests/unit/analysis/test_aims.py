"""Aims of searches that ask for single cells."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivecal.analysis.aims import JudgedGoals, WeightedScore
from drivecal.analysis.goals import Aggregate, Bound, CellValue, Goals, Objective
from drivecal.domain.evaluations import CellScore
from drivecal.domain.scales import Direction, Scale

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

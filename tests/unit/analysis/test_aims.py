"""Aims of searches that ask for single cells."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivecal.analysis.aims import JudgedGoals
from drivecal.analysis.goals import Aggregate, CellValue, Goals, Objective

SHARES = {"S0": 0.5, "S1": 0.2, "S2": 0.3}
numbers = st.floats(-1e3, 1e3)


@given(
    rows=st.lists(st.lists(numbers, min_size=3, max_size=3), min_size=1, max_size=5),
    aggregate=st.one_of(
        st.sampled_from([Aggregate("mean"), Aggregate("min"), Aggregate("max")]),
        st.floats(0, 1).map(lambda level: Aggregate("quantile", level)),
    ),
)
def test_goals_are_judged_for_many_sets_as_for_one(rows: list[list[float]], aggregate: Aggregate) -> None:
    objective = Objective("a", CellValue(measure="a"), SHARES, Aggregate("mean"), sign=-1)
    aim = JudgedGoals(Goals((replace(objective, aggregate=aggregate),), ()), tuple(SHARES))
    values = np.array([*rows, [1.0, np.nan, 2.0]])[:, :, np.newaxis]
    objectives, violations = aim.judge(values)
    expected = [-aggregate(row, list(SHARES.values())) for row in rows]
    np.testing.assert_array_equal(objectives[:-1, 0], expected)
    assert np.isnan(objectives[-1]).all()
    assert (violations[:-1] == 0).all()

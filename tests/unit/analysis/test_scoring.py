"""Scores of runs: one function for campaigns and for the check of a problem before its push."""

import pytest
from tests.support.values import COST

from drivecal.analysis.scoring import rate
from drivecal.bundles.expressions import Formula
from drivecal.domain.evaluations import Rating

FORMULA = Formula("1 / gap")


def test_a_score_is_the_formula_s_value_and_never_worse_than_a_failed_run() -> None:
    assert rate(FORMULA, COST, {"gap": 0.25, "other": 3.0}, None) == Rating(4.0, 4.0)
    assert rate(FORMULA, COST, {"gap": 0.001}, None) == Rating(100.0, 100.0, cut=1000.0)
    assert rate(FORMULA, COST, {"gap": 0.25}, "collision") == Rating(100.0, 100.0)
    assert rate(FORMULA, COST, {}, "collision") == Rating(100.0, 100.0)


def test_a_run_without_a_measure_of_the_formula_has_no_score() -> None:
    assert rate(FORMULA, COST, {"other": 1.0}, None) is None


@pytest.mark.parametrize("gap", [0.0, 1e-16, -1e-16, -1e-300])
def test_no_value_and_an_immense_one_are_undefined(gap: float) -> None:
    scored = rate(FORMULA, COST, {"gap": gap}, None)
    assert scored is not None
    assert scored.score == 100.0
    assert scored.undefined

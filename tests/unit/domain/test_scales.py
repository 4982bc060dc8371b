"""Scales: the meaning of a score's numbers."""

from dataclasses import replace

import pytest
from tests.support.values import COST

from drivecal.domain.scales import COMFORT, plain, score_text


def test_better_scores_have_a_higher_signed_value() -> None:
    assert COMFORT.is_better(6, 5.5)
    assert COST.is_better(5.5, 6)
    assert (COMFORT.lower, COMFORT.upper, COMFORT.span) == (0, 7, 7)
    assert (COST.lower, COST.upper, COST.span) == (0, 100, 100)


def test_whole_scores_are_integers_and_others_stay_what_they_are() -> None:
    assert [repr(plain(score)) for score in (6, 6.0, -0.0, 0.1 + 0.2, 1e300)] == ["6", "6", "0", repr(0.1 + 0.2), "1e+300"]
    assert (COMFORT.is_whole, COST.is_whole) == (True, False)


def test_no_run_is_worth_less_than_a_failed_one() -> None:
    assert [COMFORT.worth(score) for score in (6, 0, -3)] == [6, 0, 0]
    assert [COST.worth(score) for score in (6.5, 100, 170.25)] == [6.5, 100, 100]
    assert [COST.cuts(score) for score in (6.5, 100, 170.25)] == [False, False, True]
    assert (COMFORT.worth(7, failed=True), COST.worth(0.0, failed=True)) == (0, 100)


def test_wrong_is_more_than_the_tolerance_and_equal_is_all_but_rounding() -> None:
    assert [COMFORT.is_wrong(change) for change in (1, -1, 2, -2)] == [False, False, True, True]
    assert [COST.is_wrong(change) for change in (2.0 + 1e-9, -2.0, 2.1)] == [False, False, True]
    assert (COMFORT.rounding, COMFORT.bin, COST.bin) == (0, 1, 4)
    assert 0 < COST.rounding < 1e-6


def test_bars_are_no_narrower_than_a_hundredth_of_the_span() -> None:
    scales = [replace(COST, tolerance=tolerance) for tolerance in (0.0, 1e-9, 0.4, 0.5, 3.0, 70.0)]
    assert [scale.bin for scale in scales] == [1, 1, 1, 1, 6, 140]
    assert [scale.last_bar for scale in scales] == [100, 100, 100, 100, 17, 1]
    assert (COMFORT.last_bar, COST.last_bar, replace(COMFORT, step=1e-6, tolerance=0.0).last_bar) == (7, 25, 100)


def test_amounts_have_their_unit() -> None:
    assert [COMFORT.amount(COMFORT.tolerance), COMFORT.amount(7), COST.amount(2)] == ["1 point", "7 points", "2"]


@pytest.mark.parametrize(
    ("score", "text"),
    [(6.0, "6"), (1234567.0, "1234567"), (59.740123456789, "59.7401"), (0.0000123456789, "1.23457e-05"), (None, "-")],
)
def test_readers_get_whole_scores_whole_and_others_with_six_digits(score: float | None, text: str) -> None:
    assert score_text(score) == text

"""The self-check counts wrong answers and stops reuse where there are too many."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from drivecal.campaigns.selfcheck import Audit, clopper_pearson, count_audits
from drivecal.contracts.campaign import ErrorRate


@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_the_interval_is_that_of_scipy(counts: tuple[int, int]) -> None:
    wrong, audited = counts
    expected = stats.binomtest(wrong, audited).proportion_ci(confidence_level=0.95, method="exact")
    assert clopper_pearson(wrong, audited) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_before_the_first_audit_nothing_is_known() -> None:
    assert clopper_pearson(0, 0) == (0.0, 1.0)
    assert count_audits({"S1": ErrorRate()}, [], 0.02)["S1"].upper_95 is None


def test_a_change_by_one_is_different_and_a_change_by_two_is_wrong() -> None:
    audits = [Audit("S1", 5, 5), Audit("S1", 5, 4), Audit("S1", 5, 3), Audit("S2", 7, 7)]
    rates = count_audits({}, audits, max_error=0.9)
    assert (rates["S1"].audited, rates["S1"].different, rates["S1"].wrong) == (3, 2, 1)
    assert (rates["S2"].audited, rates["S2"].different, rates["S2"].wrong) == (1, 0, 0)


def test_reuse_stops_only_when_the_lower_end_passes_the_allowed_error() -> None:
    one_wrong = count_audits({}, [Audit("S1", 7, 0)] + [Audit("S1", 7, 7)] * 20, max_error=0.02)
    assert not one_wrong["S1"].stopped
    many_wrong = count_audits({}, [Audit("S1", 7, 0)] * 5 + [Audit("S1", 7, 7)] * 20, max_error=0.02)
    assert many_wrong["S1"].stopped


def test_reuse_stays_stopped_whatever_comes_later() -> None:
    stopped = {"S1": ErrorRate(audited=10, different=10, wrong=10, upper_95=1.0, stopped=True)}
    assert count_audits(stopped, [Audit("S1", 7, 7)] * 5_000, max_error=0.02)["S1"].stopped

"""The self-check measures the share of wrong answers."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from drivecal.contracts.campaign import ErrorRate
from drivecal.domain.evaluations import AuditCount
from drivecal.reduction.audit import clopper_pearson, error_rates, expected_error_rate


@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_the_interval_is_that_of_scipy(counts: tuple[int, int]) -> None:
    wrong, audited = counts
    expected = stats.binomtest(wrong, audited).proportion_ci(confidence_level=0.95, method="exact")
    assert clopper_pearson(wrong, audited) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_before_the_first_audit_nothing_is_known() -> None:
    assert clopper_pearson(0, 0) == (0.0, 1.0)
    assert error_rates([], ["S1"]) == {"S1": ErrorRate()}


def test_wrong_answers_are_counted() -> None:
    rate = error_rates([AuditCount("S1", audited=25, different=9, wrong=5)], ["S1"])["S1"]
    assert (rate.audited, rate.different, rate.wrong) == (25, 9, 5)
    assert rate.upper_95 is not None
    assert rate.upper_95 > 0.2


def test_audits_say_what_to_expect_of_a_reference() -> None:
    expected = [expected_error_rate(rate) for rate in (None, ErrorRate(audited=1, wrong=1), ErrorRate(audited=200, wrong=0))]
    assert expected[2] < expected[0] < 0.02 < expected[1] < 0.05, "one wrong audit says little"
    assert expected_error_rate(ErrorRate(audited=40, wrong=40)) > 0.4


def test_contradictions_and_lots_stand_beside_the_audits() -> None:
    rates = error_rates([AuditCount("S1", 10, 0, 0)], ["S1", "S2", "S3"], {"S1": 2, "S2": 7}, {"S1": (3, 0), "S3": (4, 1)})
    assert [rates[name].contradictions for name in ("S1", "S2", "S3")] == [2, 7, 0]
    assert [(rates[name].lots, rates[name].rejected) for name in ("S1", "S2", "S3")] == [(3, 0), (0, 0), (4, 1)]


def test_lots_have_the_limit_of_what_they_released_and_no_interval_over_unlike_samples() -> None:
    counts = [AuditCount(name, 278, 2, 2) for name in ("S1", "S2", "S3")]
    lots = {"S1": (21, 0), "S2": (1, 1), "S3": (0, 0)}
    rates = error_rates(counts, lots, lots=lots, released={"S1": 0.08})
    assert (rates["S1"].upper_95, rates["S2"].upper_95) == (0.08, None)
    assert rates["S3"].upper_95 == clopper_pearson(2, 278)[1]

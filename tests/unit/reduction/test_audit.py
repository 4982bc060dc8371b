"""The self-check bounds the share of wrong answers and stops reuse where there are too many."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from drivecal.contracts.campaign import ErrorRate
from drivecal.domain.evaluations import AuditCount
from drivecal.reduction.audit import clopper_pearson, error_rates, stopped_after


@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_the_interval_is_that_of_scipy(counts: tuple[int, int]) -> None:
    wrong, audited = counts
    expected = stats.binomtest(wrong, audited).proportion_ci(confidence_level=0.95, method="exact")
    assert clopper_pearson(wrong, audited) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_before_the_first_audit_nothing_is_known() -> None:
    assert clopper_pearson(0, 0) == (0.0, 1.0)
    assert error_rates([], {}, ["S1"], 0.02) == {"S1": ErrorRate()}


def test_reuse_stops_only_when_the_lower_end_passes_the_allowed_error() -> None:
    one_wrong = error_rates([AuditCount("S1", audited=21, different=1, wrong=1)], {}, ["S1"], 0.02)["S1"]
    assert (one_wrong.wrong, one_wrong.stopped) == (1, False)
    many_wrong = error_rates([AuditCount("S1", audited=25, different=5, wrong=5)], {}, ["S1"], 0.02)["S1"]
    assert many_wrong.stopped
    assert many_wrong.upper_95 is not None
    assert many_wrong.upper_95 > 0.2


def test_a_different_score_that_is_not_wrong_never_stops_reuse() -> None:
    assert not error_rates([AuditCount("S1", audited=500, different=500, wrong=0)], {}, ["S1"], 0.02)["S1"].stopped


def test_reuse_stays_stopped_whatever_comes_later() -> None:
    later = error_rates([AuditCount("S1", 5_000, 0, 0)], {"S1": ErrorRate(stopped=True)}, ["S1"], 0.02)
    assert later["S1"].stopped


def test_contradictions_stand_beside_the_audits_and_stop_nothing() -> None:
    rates = error_rates([AuditCount("S1", 10, 0, 0)], {}, ["S1", "S2", "S3"], 0.02, {"S1": 2, "S2": 7})
    assert [rates[name].contradictions for name in ("S1", "S2", "S3")] == [2, 7, 0]
    assert not any(rate.stopped for rate in rates.values())


@given(st.lists(st.integers(0, 12).flatmap(lambda n: st.tuples(st.just(n), st.integers(0, n))), max_size=8))
def test_when_reuse_was_stopped_is_found_again_from_the_audits_of_each_iteration(audits: list[tuple[int, int]]) -> None:
    listed = [(iteration, AuditCount("S1", audited, wrong, wrong)) for iteration, (audited, wrong) in enumerate(audits)]
    rate, expected = ErrorRate(), None
    for iteration, _ in listed:
        audited, wrong = (sum(one[part] for one in audits[: iteration + 1]) for part in (0, 1))
        rate = error_rates([AuditCount("S1", audited, wrong, wrong)], {"S1": rate}, ["S1"], 0.05)["S1"]
        if rate.stopped and expected is None:
            expected = iteration, AuditCount("S1", audited, wrong, wrong)
    assert stopped_after(listed, 0.05) == expected

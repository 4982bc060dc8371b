"""Lots of predictions: whatever is wrong in them, few errors are released."""

import itertools
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import betabinom, hypergeom
from tests.support.effort import examples

from drivecal.reduction import lots
from drivecal.reduction.lots import (
    DISPERSION,
    SamplingPlan,
    best_plan,
    cost_of_an_error,
    draw,
    most_released,
    outgoing_errors,
    smallest_plan,
)


@pytest.mark.parametrize(
    ("size", "limit", "sample"),
    [(250, 0.05, 16), (250, 0.02, 38), (250, 0.01, 70), (1500, 0.05, 17), (1500, 0.02, 42), (1500, 0.01, 82)],
)
def test_samples_are_those_of_the_tables_of_dodge_and_romig(size: int, limit: float, sample: int) -> None:
    assert smallest_plan(size, limit, acceptance=1).sample == sample


@given(st.integers(1, 4000), st.sampled_from([0.01, 0.02, 0.05, 0.1]), st.integers(0, 5))
def test_a_smallest_plan_keeps_the_limit_and_one_cell_less_does_not(size: int, limit: float, acceptance: int) -> None:
    plan = smallest_plan(size, limit, acceptance)
    assert outgoing_errors(plan).max() <= limit or plan.sample == plan.size
    if plan.sample > 0:
        assert plan.sample == 1 or outgoing_errors(SamplingPlan(size, plan.sample - 1, acceptance)).max() > limit


def test_the_plan_of_a_large_lot_tries_few_numbers_of_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    counted = Mock(side_effect=outgoing_errors)
    monkeypatch.setattr(lots, "outgoing_errors", counted)
    smallest_plan.cache_clear()
    plan = best_plan(50_000, 0.05, error_rate=0.01)
    assert sum(len(call.args[1]) for call in counted.call_args_list) < 50_000
    assert outgoing_errors(plan).max() <= 0.05
    assert outgoing_errors(SamplingPlan(plan.size, plan.sample - 1, plan.acceptance)).max() > 0.05


def test_a_sample_is_fixed_by_its_secret_and_unrelated_to_order_and_other_secrets() -> None:
    members = [number.to_bytes(4) for number in range(1000)]
    drawn = draw(members, 50, b"a secret")
    assert drawn == draw(members, 50, b"a secret")
    shuffled = members[::-1]
    assert {members[place] for place in drawn} == {shuffled[place] for place in draw(shuffled, 50, b"a secret")}
    assert len(set(drawn) & set(draw(members, 50, b"another"))) < 15


def test_a_lot_with_a_member_twice_and_a_limit_beyond_one_are_refused() -> None:
    with pytest.raises(ValueError, match="distinct"):
        draw([b"a", b"a"], 1, b"")
    with pytest.raises(ValueError, match=r"1\.5"):
        smallest_plan(10, 1.5, 1)


@pytest.mark.faults("0.04-0.05", "0.01-0.05", "0.15-0.05")
@pytest.mark.parametrize(("wrong_share", "limit"), [(0.0, 0.05), (0.01, 0.05), (0.04, 0.05), (0.15, 0.05), (0.02, 0.01)])
def test_the_upper_limit_of_released_errors_holds_after_every_lot_at_once(wrong_share: float, limit: float) -> None:
    """In 400 series of 15 lots, at most 5 % of the series break it after any of their lots; the errors answer to earlier verdicts."""
    generator = np.random.default_rng(7)
    broken = 0
    for _ in range(400):
        inspected: list[tuple[SamplingPlan, int]] = []
        released, share, is_broken = 0, wrong_share, False
        for size in (40, 60, 80, 100, 120) * 3:
            plan = best_plan(size, limit, wrong_share)
            wrong = int(generator.binomial(size, share))
            drawn = int(generator.hypergeometric(wrong, size - wrong, plan.sample)) if plan.sample else 0
            inspected.append((plan, drawn))
            if plan.releases(drawn) and wrong > drawn:  # the limit never falls, so that nothing else can break it
                released += wrong - drawn
                is_broken = is_broken or released > most_released(inspected) + 1e-6
            share = wrong_share * (2.0 if plan.releases(drawn) else 0.5)
        broken += is_broken
        assert most_released(inspected) <= sum(plan.size - plan.sample for plan, _ in inspected)
    assert broken <= 400 * 0.05 + 13  # three standard errors


@settings(deadline=None, max_examples=examples(20))
@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 6)), max_size=6))
def test_the_upper_limit_never_falls_from_lot_to_lot(drawn: list[tuple[int, int]]) -> None:
    plans = [smallest_plan(40, 0.05, 0), smallest_plan(100, 0.05, 1), smallest_plan(250, 0.01, 2), SamplingPlan(60, 1, 1)]
    inspected = [(plans[which], min(errors, plans[which].sample)) for which, errors in drawn]
    limits = [most_released(inspected[:count]) for count in range(len(inspected) + 1)]
    assert all(later > earlier - 1e-6 for earlier, later in itertools.pairwise(limits))


def test_the_evidence_of_a_lot_is_a_supermartingale_for_every_number_of_errors() -> None:
    """The factor of a lot has an expectation of at most 1, summed over every possible sample."""
    for plan in (smallest_plan(60, 0.05, 0), smallest_plan(200, 0.05, 1), smallest_plan(120, 0.02, 2)):
        for growth in (0.05, 0.01):
            cost = cost_of_an_error(plan, growth)
            for wrong in range(plan.size + 1):
                drawn = np.arange(plan.sample + 1)
                released = np.where(drawn <= plan.acceptance, np.maximum(wrong - drawn, 0), 0)
                charged = np.minimum(drawn, plan.acceptance + 1)
                chance = hypergeom.pmf(drawn, plan.size, wrong, plan.sample)
                assert float((chance * np.exp(growth * released - cost * charged)).sum()) <= 1.0 + 1e-6


def test_chances_are_those_of_scipy() -> None:
    for plan in (SamplingPlan(40, 7, 2), SamplingPlan(300, 16, 1), SamplingPlan(25, 25, 0), SamplingPlan(5, 2, 3)):
        wrong = np.arange(plan.size + 1)
        expected = sum(
            hypergeom.pmf(drawn, plan.size, wrong, plan.sample) * np.maximum(wrong - drawn, 0)
            for drawn in range(plan.acceptance + 1)
        )
        assert outgoing_errors(plan) == pytest.approx(np.nan_to_num(expected) / plan.size, abs=1e-12)
        for rate in (0.001, 0.05, 0.4):
            shapes = rate * DISPERSION, (1.0 - rate) * DISPERSION
            released = (plan.size - plan.sample) * betabinom.cdf(plan.acceptance, plan.sample, *shapes)
            assert plan.expected_saving(rate) == pytest.approx(released)

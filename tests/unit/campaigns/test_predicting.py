"""When a predictor is asked, and in which batches."""

import math
from dataclasses import replace
from decimal import Decimal
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.storage import new_evaluation

from drivecal.campaigns.cells import predicting
from drivecal.campaigns.cells.predicting import (
    ASKING_SECONDS,
    LIKELY,
    LotPlanner,
    batch_of,
    pays,
    released_by_scenario,
    skipped_text,
    slice_size,
    training_seconds,
)
from drivecal.contracts.specification import ReductionSpecification
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Outcome
from drivecal.domain.parameters import Parameter, ParameterSpace
from drivecal.domain.scales import COMFORT
from drivecal.reduction.prediction import FEWEST_KNOWN, Predictions
from drivecal.storage import lots
from drivecal.storage.lots import LotVerdict, StoredLot

NOTHING: Any = None


def lot(size: int, sample: int = 16, *, seconds: float = 1.0, known: int = 1000, errors: int | None = 0) -> StoredLot:
    verdict = None if errors is None else LotVerdict.RELEASED if errors <= 1 else LotVerdict.REJECTED
    return StoredLot(1, 0, "S1", size, sample, 1, 0.0, 0.05, known, seconds, Outcome.PREDICTED, 1, verdict, errors)


PARAMETERS = 11
TRAINING = training_seconds(1000, PARAMETERS)
"""CPU seconds; cells take a hundredth of it in the tests below."""
SHARE_ASKED = ASKING_SECONDS / TRAINING


def just_paid(share: float, *, paid: bool = True) -> StoredLot:
    """The lot that saves so many hundredths of a training, or one cell less."""
    return lot(16 + math.ceil(100 * share - 1e-9) - (0 if paid else 1))


@pytest.mark.parametrize(
    ("lots_so_far", "known", "cell_seconds", "expected"),
    [
        ([], 100, 0.0, True),
        ([just_paid(1 + SHARE_ASKED)], 1100, TRAINING / 100, True),
        ([just_paid(1 + SHARE_ASKED, paid=False)], 1100, TRAINING / 100, False),
        ([lot(0, 0)], 1250, (TRAINING + ASKING_SECONDS) / (LIKELY * 99), True),
        ([lot(0, 0)], 1250, (TRAINING + ASKING_SECONDS) / (LIKELY * 101), False),
        ([lot(0, 0), just_paid(1 + 2 * SHARE_ASKED)], 1100, TRAINING / 100, True),
        ([lot(216, errors=2), just_paid(1 + SHARE_ASKED)], 1100, TRAINING / 100, False),
        ([lot(200), lot(0, 0, known=1100)], 1374, 1.0, False),
        ([lot(200), lot(0, 0, known=1100)], 1375, 1.0, True),
    ],
)
def test_a_predictor_is_trained_if_it_saves_more_than_it_costs(
    lots_so_far: list[StoredLot], known: int, cell_seconds: float, expected: bool
) -> None:
    assert pays(lots_so_far, known, 100, PARAMETERS, cell_seconds) is expected


@pytest.mark.parametrize(
    ("again", "expected"),
    [
        ([], True),
        ([lot(0, 0)], True),
        ([lot(216, errors=2), lot(0, 0)], True),
        ([lot(0, 0)] * 2 + [just_paid(3 * SHARE_ASKED)], True),
        ([lot(0, 0)] * 2 + [just_paid(3 * SHARE_ASKED, paid=False)], False),
        ([lot(0, 0)] * 3 + [just_paid(4 * SHARE_ASKED)], True),
        ([just_paid(2 * SHARE_ASKED), lot(0, 0), lot(0, 0)], False),
    ],
)
def test_a_trained_predictor_is_asked_again_a_few_times_and_then_if_its_predictions_alone_pay(
    again: list[StoredLot], expected: bool
) -> None:
    """Training costs ten times as much as its first lot saved: that is spent, and predicting costs little."""
    assert pays([lot(26), *again], 1099, 100, PARAMETERS, TRAINING / 100) is expected


def test_a_predictor_that_is_trained_once_more_after_a_crash_is_judged_as_before() -> None:
    served = [just_paid(1 + 2 * SHARE_ASKED), lot(0, 0)]
    trained_again = [served[0], replace(served[1], seconds=60.0)]
    for known in (1000, 1100, 1250):
        assert pays(served, known, 100, PARAMETERS, TRAINING / 100) is pays(
            trained_again, known, 100, PARAMETERS, TRAINING / 100
        )


def test_batches_are_slices_of_the_start_population_then_generations() -> None:
    size = slice_size(1000)
    assert size == slice_size(100_000) == 250
    places = [
        (StageName.SENSITIVITY, 3, 7), (StageName.CALIBRATION, 0, 249), (StageName.CALIBRATION, 0, 250),
        (StageName.CALIBRATION, 1, 0), (StageName.CALIBRATION, 2, 0),
    ]  # fmt: skip
    batches = [batch_of(*place, size) for place in places]
    assert batches == sorted(set(batches))
    assert batch_of(StageName.CALIBRATION, 1, 999, size) == batches[3]


@given(st.integers(1, 5000))
def test_the_first_slice_that_others_follow_is_enough_to_predict_the_next(population: int) -> None:
    size = slice_size(population)
    assert FEWEST_KNOWN <= size <= 250
    assert -(-population // size) <= max(4, -(-population // 250))


def test_rejected_lots_and_lots_without_a_verdict_release_nothing() -> None:
    stored = [lot(116), lot(216, errors=3), lot(316, errors=None), lot(0, 0, errors=None)]
    by_scenario = released_by_scenario(stored, ["S1", "S2"], 0.05, batches=6, number=lambda _: 1, sizes={"S1": (0.1, 0.5)})
    released = by_scenario["S1"]
    assert [(each.asked, each.batches) for each in by_scenario.values()] == [(4, 6), (0, 6)]
    assert [each.early for each in by_scenario.values()] == [1, 6]
    text = skipped_text(by_scenario)
    assert text is not None
    early, late, unsure = text.split(";")
    assert "S1 (1 of 6)" in early
    assert "S2 (6 of 6)" in early
    assert "S1 (1 of 6)" in late
    assert "S2" not in late
    assert "S1 (2 of 6)" in unsure
    assert "S2" not in unsure
    assert skipped_text({"S1": released.model_copy(update={"asked": 6, "early": 0, "lots": 6})}) is None
    assert (released.lots, released.rejected, released.predicted, released.sampled, released.different) == (2, 1, 100, 32, 3)
    assert released.seconds == 4.0
    assert [(each.mean_error, each.largest_error) for each in by_scenario.values()] == [(0.1, 0.5), (None, None)]
    assert released.upper_95 is not None
    assert 0.0 < released.upper_95 <= 1.0


def test_sets_within_reach_of_the_best_one_are_simulated_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """By their predicted objective, or by two standard deviations above the believed mean."""
    monkeypatch.setattr(lots, "insert", lambda _, __, new: list(range(len(new))))
    space = ParameterSpace((Parameter("P1", Decimal(0), Decimal(1), 11),))
    view: Any = SimpleNamespace(names=("P1",), campaign=1, bench=SimpleNamespace(scale=COMFORT))
    weights = {"S1": 0.5, "S2": 0.5}
    planner = LotPlanner(view, space, ReductionSpecification(mode="predicted"), weights, 200)
    cells = [
        new_evaluation(StageName.CALIBRATION, 1, place, scenario, 1, place, Outcome.SIMULATED)
        for place in range(98)
        for scenario in weights
    ]
    scores, variances = np.full(98, 4.0), np.zeros(98)
    means = scores.copy()
    scores[0], scores[1], means[2:4], variances[2:4] = 6.0, 5.5, 5.0, (0.5, 0.49)
    predictions = Predictions(scores, scores, np.ones(98), means, variances)
    planner._rows = {place: place for place in range(98)}
    planner._forecasts = {name: predicting._Forecast(predictions, np.zeros(98), 500, 3.0) for name in weights}
    planned = planner.plan(NOTHING, cells, 6.0, ())
    assert {cell.individual for cell in planned if cell.plan is Outcome.SIMULATED} == {0, 2}
    assert {cell.individual for cell in planned if cell.plan is Outcome.PREDICTED} == {1, *range(3, 98)}

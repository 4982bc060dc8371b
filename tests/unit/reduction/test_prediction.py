"""Predictions: the calibration of confidences, the choice of a lot, and the forest behind them."""

import subprocess
import sys
from decimal import Decimal
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.domain.parameters import Parameter, ParameterSet, ParameterSpace
from drivecal.reduction.forest import Forest
from drivecal.reduction.lots import MOST_ACCEPTED, outgoing_errors, smallest_plan
from drivecal.reduction.prediction import FINENESS, ROOM, ConfidenceRecord, FeatureSpace, Floats, choose_lot, lot_sizes

GENERATOR = np.random.default_rng(3)
SETS = GENERATOR.random((600, 4))
SCORES: Floats = np.round(7.0 * (1.0 - np.abs(SETS[:, 0] - 0.5) - 0.5 * SETS[:, 1] ** 2)).clip(0.0, 7.0)
RATINGS: Floats = (SCORES + 0.3 * np.sin(9.0 * SETS[:, 2])).clip(0.0, 7.0)


def learned(tolerance: float = 0.0) -> Forest:
    forest = Forest(tolerance)
    forest.fit(SETS[:400], SCORES[:400], RATINGS[:400])
    return forest


def test_without_a_record_nothing_is_expected_to_be_right() -> None:
    assert ConfidenceRecord().error_rates(np.array([0.2, 1.0])).tolist() == [1.0, 1.0]
    assert choose_lot(np.ones(500), 0.05) is None


@given(st.lists(st.tuples(st.floats(0, 1), st.booleans(), st.floats(0.5, 30)), min_size=1, max_size=60))
def test_error_rates_never_rise_with_the_confidence(record: list[tuple[float, bool, float]]) -> None:
    calibration = ConfidenceRecord()
    confidence, wrong, weight = (np.array(column) for column in zip(*record, strict=True))
    calibration.add(confidence, wrong, weight)
    rates = calibration.error_rates(np.linspace(0.0, 1.0, 101))
    assert ((rates >= 0.0) & (rates <= 1.0)).all()
    assert (np.diff(rates) <= 1e-12).all()


def test_a_long_record_is_reproduced() -> None:
    confidence = GENERATOR.random(50_000)
    calibration = ConfidenceRecord()
    calibration.add(confidence, GENERATOR.random(50_000) > confidence)
    at = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
    assert calibration.error_rates(at) == pytest.approx(1.0 - at, abs=0.04)


def test_a_sampled_prediction_stands_for_its_lot() -> None:
    calibration = ConfidenceRecord()
    calibration.add(np.full(1000, 0.9), np.zeros(1000, dtype=bool))
    calibration.add(np.full(20, 0.9), np.ones(20, dtype=bool), weight=50.0)
    assert calibration.error_rates(np.array([0.95]))[0] == pytest.approx(0.5, abs=0.02)


@given(st.lists(st.floats(0, 1), max_size=80), st.sampled_from([0.01, 0.05]))
def test_a_lot_holds_the_most_certain_predictions_and_keeps_the_limit(rates: list[float], limit: float) -> None:
    lot = choose_lot(np.array(rates), limit)
    if lot is not None:
        left = np.setdiff1d(np.arange(len(rates)), lot.members)
        assert not len(left) or max(rates[member] for member in lot.members) <= min(rates[place] for place in left)
        assert lot.plan.size == len(lot.members)
        assert outgoing_errors(lot.plan).max() <= limit or lot.plan.sample == lot.plan.size


@given(st.lists(st.floats(0, 0.3), max_size=80), st.sampled_from([0.01, 0.05]))
def test_no_other_size_of_a_lot_is_expected_to_save_more(rates: list[float], limit: float) -> None:
    expected = np.cumsum(np.sort(rates)) / np.arange(1, len(rates) + 1)
    savings = [
        smallest_plan(size, limit, acceptance).expected_saving(float(expected[size - 1]))
        for size in lot_sizes(len(rates))
        if expected[size - 1] <= ROOM * limit
        for acceptance in range(MOST_ACCEPTED + 1)
    ]
    lot = choose_lot(np.array(rates), limit)
    saving = 0.0 if lot is None else lot.plan.expected_saving(float(expected[lot.plan.size - 1]))
    assert saving == pytest.approx(max([saved for saved in savings if saved >= 1.0], default=0.0))


@given(st.integers(0, 100_000))
def test_lot_sizes_are_few_and_close_and_the_same_in_every_batch(most: int) -> None:
    sizes = lot_sizes(most)
    assert sizes == [size for size in lot_sizes(100_000) if size <= most]
    assert sizes[:1] == [1][:most]
    assert all(larger - size <= max(1, size / FINENESS) for size, larger in pairwise(sizes))
    assert len(sizes) <= 2 * FINENESS + FINENESS * max(most, 1).bit_length()


def test_the_forest_is_better_than_its_most_frequent_score_and_knows_when() -> None:
    told = learned().predict(SETS[400:])
    wrong, confidence = told.scores != SCORES[400:], told.confidence
    values, counts = np.unique(SCORES[:400], return_counts=True)
    assert wrong.mean() < (SCORES[400:] != values[counts.argmax()]).mean() / 2
    certain = confidence > np.median(confidence)
    assert wrong[certain].mean() < wrong[~certain].mean()


def test_a_tolerance_counts_neighbouring_scores() -> None:
    told = learned(tolerance=1.0).predict(SETS[400:])
    assert (np.abs(told.scores - SCORES[400:]) > 1.0).mean() < 0.05
    assert (told.confidence >= learned().predict(SETS[400:]).confidence - 1e-12).all()


def test_a_single_known_score_is_predicted_everywhere() -> None:
    forest = Forest()
    forest.fit(SETS[:5], np.full(5, 3.0), np.full(5, 3.2))
    told = forest.predict(SETS[5:9])
    assert told.scores.tolist() == [3.0] * 4
    assert told.ratings.tolist() == pytest.approx([3.2] * 4)
    assert told.confidence.tolist() == [1.0] * 4


def bits() -> str:
    told = learned().predict(SETS[400:])
    return " ".join(part.tobytes().hex() for part in (told.scores, told.ratings, told.confidence))


@pytest.mark.slow
def test_predictions_have_the_same_bits_in_another_process() -> None:
    script = "from tests.unit.reduction.test_prediction import bits;print(bits())"
    here = bits()
    there = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)  # this test itself
    assert there.stdout.strip() == here


def test_mean_and_variance_are_those_of_the_votes() -> None:
    forest = learned()
    told = forest.predict(SETS[400:420])
    for place, (mean, variance) in enumerate(zip(told.mean, told.variance, strict=True)):
        shared = (forest._leaves == forest._leaves_of(SETS[400 + place : 401 + place])) * forest._drawn
        weights = (shared / shared.sum(axis=1, keepdims=True)).mean(axis=0)
        assert mean == pytest.approx(weights @ SCORES[:400])
        assert variance == pytest.approx(weights @ (SCORES[:400] - mean) ** 2)


def test_sets_of_other_parameters_are_no_training_data() -> None:
    speed, mode = Parameter.from_step("v", Decimal(0), Decimal(1), Decimal("0.1")), Parameter.choice("mode", ["eco", "sport"])
    features = FeatureSpace(ParameterSpace((speed, mode)), ("v", "mode"))
    assert features.holds(ParameterSet.of({"mode": "eco", "v": Decimal("0.5")}))
    others: tuple[dict[str, Decimal | str], ...] = (
        {"v": Decimal("0.5")},
        {"v": Decimal("0.5"), "mode": "eco", "x": Decimal(1)},
        {"v": Decimal("0.5"), "mode": "race"},
        {"v": Decimal("0.5"), "mode": Decimal(1)},
        {"v": "eco", "mode": "eco"},
    )
    for other in others:
        assert not features.holds(ParameterSet.of(other))

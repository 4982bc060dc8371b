"""Batches that use a predictor."""

from decimal import Decimal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.databases import migrated
from tests.support.storage import campaign, new_evaluation

from drivecal.campaigns.cells import predicting
from drivecal.campaigns.cells.planning import ReuseTime
from drivecal.campaigns.cells.predicting import (
    ASKING_SECONDS,
    LotPlanner,
    batch_of,
    expected_saving,
    released_by_scenario,
    slice_size,
    training_seconds,
)
from drivecal.contracts.specification import ReductionSpecification
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Outcome
from drivecal.domain.parameters import Parameter, ParameterSpace
from drivecal.domain.scales import COMFORT
from drivecal.reduction.assignment import LIKELY
from drivecal.reduction.prediction import FEWEST_KNOWN, Predictions
from drivecal.storage.lots import LotVerdict, StoredLot


def lot(size: int, sample: int = 16, *, seconds: float = 1.0, known: int = 1000, errors: int | None = 0) -> StoredLot:
    verdict = None if errors is None else LotVerdict.RELEASED if errors <= 1 else LotVerdict.REJECTED
    return StoredLot(1, 0, "S1", size, sample, 1, 0.0, 0.05, known, seconds, Outcome.PREDICTED, 1, verdict, errors)


PARAMETERS, SECONDS = 11, 0.005
AHEAD = 3000.0, 10.0
SPACE = ParameterSpace((Parameter("P1", Decimal(0), Decimal(1), 11),))


def planner_of(weights: dict[str, float]) -> LotPlanner:
    view: Any = SimpleNamespace(names=("P1",), campaign=1, bench=SimpleNamespace(scale=COMFORT), reuse_time=ReuseTime())
    return LotPlanner(view, SPACE, ReductionSpecification(mode="predicted"), weights, 200)


def nets(served: list[StoredLot], ahead: tuple[float, float] = AHEAD, known: int = 1000) -> float:
    saved, cost = expected_saving(served, known, ahead, PARAMETERS, SECONDS)
    return saved - cost


def test_predictions_are_expected_to_save_a_share_of_what_is_ahead_until_lots_say_how_much() -> None:
    saved, cost = expected_saving([], 1000, AHEAD, PARAMETERS, SECONDS)
    assert saved == pytest.approx(LIKELY * 3000 * SECONDS)
    assert training_seconds(1000, PARAMETERS) < cost < 10 * (training_seconds(4000, PARAMETERS) + ASKING_SECONDS)
    assert expected_saving([], 1000, AHEAD, PARAMETERS, 2 * SECONDS)[0] == pytest.approx(2 * saved)
    better, worse = [lot(216)] * 3, [lot(0, 0), lot(216, errors=2)] * 3
    assert nets(better) > nets([]) > nets(worse)
    assert nets([lot(216)] * 20 + worse) == pytest.approx(nets(worse))


def test_predictions_never_save_more_cells_than_are_ahead() -> None:
    saved, _ = expected_saving([lot(5016)] * 6, 1000, (100.0, 1.0), PARAMETERS, SECONDS)
    assert saved == pytest.approx(100 * SECONDS)


def test_a_training_that_was_done_costs_nothing_more() -> None:
    once = (100.0, 1.0)
    assert nets([lot(0, 0)], once, known=1099) > nets([lot(0, 0)], once, known=1100) + training_seconds(1000, PARAMETERS) / 2


def test_a_predictor_that_is_trained_once_more_after_a_crash_is_judged_as_before() -> None:
    assert nets([lot(216, seconds=60.0), lot(0, 0)]) == nets([lot(216), lot(0, 0)])


@pytest.mark.parametrize(("seconds", "begins"), [(0.0, False), (0.001, False), (0.1, True)])
def test_predictions_begin_if_they_save_more_than_they_cost_and_say_why_not(seconds: float, begins: bool) -> None:
    planner = planner_of({"S1": 0.5, "S2": 0.5})
    assert planner.is_ready(*AHEAD)
    assert planner.off is None  # nothing is known so far
    for learner in planner._learners.values():
        learner.learn(np.random.default_rng(1).random((200, 1)), np.ones(200), np.ones(200))
    planner._recent_seconds = seconds
    if not planner.is_ready(*AHEAD):
        predicting._LOADING.join()
    assert planner.is_ready(*AHEAD)
    assert (planner._chosen, planner.off is None) == ({"S1", "S2"} if begins else set(), begins)
    planner.predict({1: SPACE.parameter_sets(np.array([[3]]))[0]})
    assert set(planner._forecasts) == planner._chosen


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
    by_scenario = released_by_scenario(stored, ["S1", "S2"], 0.05, {"S1": (0.1, 0.5)})
    released = by_scenario["S1"]
    assert [each.asked for each in by_scenario.values()] == [4, 0]
    assert (released.lots, released.rejected, released.predicted, released.sampled, released.different) == (2, 1, 100, 32, 3)
    assert released.seconds == 4.0
    assert [(each.mean_error, each.largest_error) for each in by_scenario.values()] == [(0.1, 0.5), (None, None)]
    assert released.upper_95 is not None
    assert 0.0 < released.upper_95 <= 1.0


def test_sets_within_reach_of_the_best_one_are_simulated_whole(tmp_path: Path) -> None:
    """By their predicted objective, or by two standard deviations above the believed mean."""
    weights = {"S1": 0.5, "S2": 0.5}
    planner = planner_of(weights)
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
    database = migrated(f"sqlite:///{tmp_path / 'drivecal.db'}")
    with database.transaction() as connection:
        assert campaign(connection).sequence == 1
        planned = planner.plan(connection, cells, 6.0, ())
    assert {cell.individual for cell in planned if cell.plan is Outcome.SIMULATED} == {0, 2}
    assert {cell.individual for cell in planned if cell.plan is Outcome.PREDICTED} == {1, *range(3, 98)}

"""Predicted answers in whole campaigns: each lot, sample and verdict is stored at once, also if dispatchers die meanwhile."""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.support.computed import ComputedBackend
from tests.support.databases import migrated
from tests.support.deaths import ends_in_spite_of_deaths
from tests.support.effort import tries
from tests.support.problems import LIMITS
from tests.support.runs import (
    EXPERT_SPACE,
    dispatcher,
    everything,
    get,
    influenced,
    lots_of,
    post_map,
    rows_of,
    run,
    run_posted,
    step_until,
    study_of,
    submit,
)
from tests.support.server import RunningApi
from tests.support.storage import new_evaluation
from tests.support.values import present

from drivecal.analysis.verdicts import confirmation_verdict
from drivecal.api import submission
from drivecal.campaigns.cells.predicting import LotPlanner, slice_size
from drivecal.campaigns.results.explanation import explain
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.results import Accounting
from drivecal.contracts.specification import RerunSpecification
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Outcome, Purpose
from drivecal.storage import evaluations, lots
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.lots import LotVerdict
from drivecal.storage.maintenance.consistency import verify

ITERATIONS = 4
STRIDE = tries(27, 9)
"""Moments between two deaths."""
SPACE = [{**parameter, "step": 0.05} for parameter in EXPERT_SPACE]


def slowly(scenario: str, cell: Cell) -> CellResult:
    """Runs so expensive that the predictor always pays."""
    return replace(influenced(scenario, cell), milliseconds=500.0)


def ask(database: Database, *, population: int = 160, seed: int = 3, **changes: Any) -> StoredCampaign:
    return submit(
        database,
        parameters=SPACE,
        catalogue=["S1", "S2"],
        optimizer={"kind": "genetic", "population": population, "iterations": ITERATIONS, "seed": seed},
        reduction={"mode": "predicted", "confirm": 0} | changes,
    )


@pytest.fixture(scope="module")
def predicted(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Database, StoredCampaign]]:
    database = migrated(f"sqlite:///{tmp_path_factory.mktemp('predicted') / '1.db'}")
    yield database, run(database, ask(database, population=280), ComputedBackend(answer=slowly))
    database.dispose()


def test_a_sample_is_compared_and_its_lot_released_or_simulated_whole(predicted: tuple[Database, StoredCampaign]) -> None:
    database, campaign = predicted
    rows = rows_of(database, campaign)
    for lot in (lot for lot in lots_of(database, campaign) if lot.size):
        members = [row for row in rows if row.lot == lot.id]
        sample = [row for row in members if row.purpose == "sample"]
        assert (len(members), len(sample)) == (lot.size, lot.sample)
        assert lot.errors == sum(row.agrees is False for row in sample)
        assert all(row.agrees == (row.score == row.predicted_score) for row in sample)
        rest = {row.outcome for row in members if row.purpose != "sample"}
        assert lot.verdict is (LotVerdict.RELEASED if lot.errors <= lot.acceptance else LotVerdict.REJECTED)
        assert rest <= ({Outcome.PREDICTED} if lot.verdict is LotVerdict.RELEASED else {Outcome.SIMULATED, Outcome.FAILED})


@pytest.mark.slow
@pytest.mark.parametrize(("mode", "budget"), [("both", 200), ("predicted", 360)])
def test_individuals_for_which_the_budget_does_not_suffice_wait_for_verdicts(tmp_path: Path, mode: str, budget: int) -> None:
    """Lots of references and of predictions may save what they could cost, so the whole budget is used, also if dispatchers die."""
    answer = simple if mode == "both" else slowly
    ignored = {f"P{number}": {"influential": False} for number in range(2, 12)}

    def ended(name: str, lives: Iterable[int]) -> tuple[Any, ...]:
        database = migrated(f"sqlite:///{tmp_path / name}")
        campaign = submit(
            database,
            stored_map=post_map(database, {"S1": ignored}) if mode == "both" else None,
            parameters=SPACE,
            catalogue=["S1", "S2"],
            optimizer={"kind": "genetic", "population": 160, "seed": 3},
            budget={"simulations": budget},
            reduction={"mode": mode, "audit": 0.0, "max_error": 0.05, "confirm": 0},
        )
        for steps in lives:
            working = dispatcher(database, ComputedBackend(answer=answer))
            while steps and get(database, campaign).ended_at is None:
                working.step()
                steps -= 1
        end = run(database, campaign, ComputedBackend(answer=answer))
        assert [check for check in verify(database) if check.problems] == []
        released = {lot.kind for lot in lots_of(database, campaign) if lot.verdict is LotVerdict.RELEASED}
        rows = everything(database, campaign)
        database.dispose()
        assert present(end.search).ended_by == "budget"
        assert end.cells.runs - end.cells.lost in {budget - 1, budget}, "no further set fits"
        return rows, released

    whole = ended("whole.db", [])
    assert whole[1] == {Outcome.PREDICTED} | ({Outcome.REUSED} if mode == "both" else set())
    assert ended("killed.db", [6] * 30) == whole


def test_sizes_of_errors_are_those_in_the_samples_of_released_lots(predicted: tuple[Database, StoredCampaign]) -> None:
    database, campaign = predicted
    released = {lot.id: lot for lot in lots_of(database, campaign) if lot.verdict is LotVerdict.RELEASED}
    for scenario, summary in campaign.released.items():
        sampled = [
            row
            for row in rows_of(database, campaign)
            if row.purpose == "sample" and row.lot in released and row.scenario == scenario
        ]
        sizes = [abs((row.score or 0) - (row.predicted_score or 0)) for row in sampled]
        weights = [released[row.lot or 0].size / released[row.lot or 0].sample for row in sampled]
        assert summary.largest_error == max(sizes, default=None)
        if sizes:
            mean = sum(size * weight for size, weight in zip(sizes, weights, strict=True)) / sum(weights)
            assert summary.mean_error == pytest.approx(mean)
    assert any(summary.largest_error is not None for summary in campaign.released.values())


def test_the_best_set_has_no_predicted_score(predicted: tuple[Database, StoredCampaign]) -> None:
    database, campaign = predicted
    best = Cell(1, present(campaign.best).parameters)
    assert present(campaign.best).scores == {name: slowly(name, best).score for name in ("S1", "S2")}
    predicted_sets = {row.parameter_set_id for row in rows_of(database, campaign) if row.outcome is Outcome.PREDICTED}
    with database.read() as connection:
        answers = [row for row in rows_of(database, campaign) if row.parameters.floats == present(campaign.best).parameters]
        known, _ = lots.known_answers(connection, campaign.sequence, {row.setup_id for row in answers}, 0)
    assert not {row.parameter_set_id for row in answers} & predicted_sets
    own = {(row.iteration, row.individual, row.scenario): row.outcome for row in rows_of(database, campaign)}
    learned = {own[answer.iteration, answer.individual, answer.scenario] for answer in known}
    assert learned <= {Outcome.SIMULATED}


@pytest.mark.slow
def test_a_predictor_that_errs_has_its_lots_rejected(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sabotaged predictor claims to be certain, and is wrong by a point."""
    from drivecal.reduction.forest import Forest

    predict = Forest.predict

    def sabotaged(self: Forest, features: Any) -> Any:
        right = predict(self, features)
        return replace(right, scores=right.scores + 1.0, confidence=right.confidence * 0.0 + 1.0)

    monkeypatch.setattr(Forest, "predict", sabotaged)
    monkeypatch.setattr(Forest, "known_errors", lambda self: (self._scores * 0.0 + 1.0, self._scores < 0.0))
    campaign = run(database, ask(database, population=280), ComputedBackend(answer=slowly))
    inspected = [lot for lot in lots_of(database, campaign) if lot.size]
    assert inspected
    assert all(lot.verdict is LotVerdict.REJECTED for lot in inspected)
    assert campaign.cells.predicted == 0
    honest = run(database, ask(database, population=280, mode="off"), ComputedBackend(answer=slowly))
    assert campaign.best == honest.best


@pytest.mark.slow
@pytest.mark.parametrize("milliseconds", [500.0, 0.5])
def test_a_dispatcher_killed_at_any_moment_draws_the_same_samples(tmp_path: Path, milliseconds: float) -> None:
    """Cheap simulations are not predicted, because predicting would cost more."""

    def answer(scenario: str, cell: Cell) -> CellResult:
        return replace(influenced(scenario, cell), milliseconds=milliseconds)

    def begin(database: Database) -> StoredCampaign:
        campaign = ask(database)
        working = dispatcher(database, ComputedBackend(answer=answer))
        step_until(database, campaign, 1, working)
        while milliseconds > 1 and not any(lot.size for lot in lots_of(database, campaign)):
            assert not get(database, campaign).state.ended, "it ended without a lot"
            working.step()
        return campaign

    def find(database: Database, campaign: StoredCampaign) -> tuple[Any, ...]:
        return everything(database, campaign), [replace(lot, seconds=0.0) for lot in lots_of(database, campaign)]

    ends = ends_in_spite_of_deaths(tmp_path, begin, lambda moment: ComputedBackend(moment, answer=answer), find, STRIDE)
    assert len(ends) > tries(2, 5)
    assert all(end == ends[0] for end in ends)
    asked, batches = len(ends[0][1]), 2 * ITERATIONS  # in two scenarios; the first slice has none
    fewest = batches - 2  # with some secrets a batch has only known answers, or no certain prediction
    assert asked >= fewest if milliseconds > 1 else asked == 0
    assert any(lot.verdict is LotVerdict.RELEASED for lot in ends[0][1]) == (milliseconds > 1)


def test_released_predictions_are_simulated_afterwards_by_a_study(predicted: tuple[Database, StoredCampaign]) -> None:
    database, campaign = predicted
    validation = {"of": campaign.id, "samples": 1_000_000}
    study = submit(database, parameters=SPACE, catalogue=["S1", "S2"], optimizer=None, validation=validation)
    ended = run(database, study, ComputedBackend(answer=slowly))
    rows = study_of(database, ended, StageName.VALIDATION)["items"]
    released = [row for row in rows_of(database, campaign) if row.outcome is Outcome.PREDICTED]
    for row in rows:
        here = [cell for cell in released if cell.scenario == row["scenario"]]
        differences = [(cell.score or 0) - (slowly(cell.scenario, Cell(1, cell.parameters.floats)).score or 0) for cell in here]
        assert (row["released"], row["compared"]) == (len(here), len(here))
        assert row["beyond"] == row["different"] == sum(difference != 0 for difference in differences)
    assert get(database, study).cells.requested == 0


def test_a_confirming_simulation_is_explained_by_its_prediction(predicted: tuple[Database, StoredCampaign]) -> None:
    database, campaign = predicted
    believed = next(row for row in rows_of(database, campaign) if row.outcome is Outcome.PREDICTED)
    place = believed.stage, ITERATIONS, 0, believed.scenario, believed.setup_id, believed.parameter_set_id
    with database.transaction() as connection:
        (confirming,) = evaluations.insert(
            connection, campaign.sequence, [new_evaluation(*place, Outcome.SIMULATED, purpose=Purpose.CONFIRMATION)]
        )
        explanation = explain(connection, confirming)
        connection.rollback()
    assert (explanation.reason, explanation.reference) == ("checked", None)
    assert explanation.prediction is not None
    assert (explanation.prediction.score, explanation.prediction.confidence) == (believed.predicted_score, believed.confidence)
    assert present(explanation.prediction.lot).id == believed.lot


def simple(scenario: str, cell: Cell) -> CellResult:
    """Scores in steps of one parameter, so that every prediction is right."""
    del scenario
    score = round(6 * cell.parameters["P1"])
    return CellResult(cell.id, float(score), score, {"rating": float(score)}, None, 500.0)


@pytest.mark.slow
def test_a_set_that_was_dismissed_on_a_prediction_gets_a_last_look(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A predictor that finds every set bad hides the best ones; with all answers it sees them, also if the dispatcher was killed."""
    from drivecal.reduction.forest import Forest

    predict, looked = Forest.predict, LotPlanner.worth_a_look

    def pessimistic(self: Forest, features: Any) -> Any:
        right = predict(self, features)
        nothing = right.scores * 0.0
        return replace(right, scores=right.scores.clip(None, 3.0), mean=nothing, variance=nothing)

    def look(self: LotPlanner, *arguments: Any) -> list[int]:
        monkeypatch.setattr(Forest, "predict", predict)
        return looked(self, *arguments)

    def ended(name: str, deaths: int) -> tuple[StoredCampaign, set[int]]:
        database = migrated(f"sqlite:///{tmp_path / name}")
        monkeypatch.setattr(Forest, "predict", pessimistic)
        campaign = ask(database, population=200, confirm=20, tolerance=7.0)
        working = dispatcher(database, ComputedBackend(answer=slowly))
        for _ in range(20_000):
            working.step()
            if (now := get(database, campaign)).state.ended:
                break
            if deaths and now.search is not None and now.search.last_look:
                deaths, working = deaths - 1, dispatcher(database, ComputedBackend(answer=slowly))
        own = [row.parameter_set_id for row in rows_of(database, campaign) if row.outcome is Outcome.SIMULATED]
        return now, {number for number, count in Counter(own).items() if count == 2}

    monkeypatch.setattr(LotPlanner, "worth_a_look", look)
    (campaign, whole), (killed, _) = ended("a.db", 0), ended("b.db", 3)
    last = present(campaign.search).last_look
    assert last
    assert set(last) <= whole
    assert campaign.confirmation is not None
    assert campaign.confirmation.dismissed > 0
    assert f"{campaign.confirmation.dismissed:,} sets dismissed" in confirmation_verdict(campaign.confirmation).text
    assert (killed.best, killed.confirmation, present(killed.search).last_look) == (campaign.best, campaign.confirmation, last)


@pytest.mark.slow
def test_a_search_whose_scenarios_are_known_ends_with_a_set_that_was_simulated(database: Database) -> None:
    """Each set has a predicted score in one of many scenarios, so that none is ranked unless some are simulated whole."""

    def searched(seed: int) -> StoredCampaign:
        wanted = submit(
            database,
            parameters=SPACE,
            catalogue=[f"S{number}" for number in range(1, 7)],
            optimizer={"kind": "random", "population": 100, "iterations": 2, "seed": seed},
            reduction={"mode": "predicted", "confirm": 20},
        )
        return run(database, wanted, ComputedBackend(answer=simple))

    searched(1)
    ended = searched(2)
    assert ended.cells.predicted > 0.8 * ended.cells.requested
    assert present(ended.best).objective == 6.0


def test_a_rerun_predicts_from_what_the_first_campaign_simulated(database: Database) -> None:
    first = run(database, ask(database, population=280), ComputedBackend(answer=slowly))
    wanted = RerunSpecification.model_validate({"weights": {"S1": 3.0}, "optimizer": {"kind": "genetic", "seed": 4}})
    again = submission.rerun(database, LIMITS, first.id, wanted, None)
    ended = run(database, again, ComputedBackend(answer=slowly))
    counts = Counter(row.outcome for row in rows_of(database, ended))
    assert ended.cells.predicted == counts[Outcome.PREDICTED] > 0
    assert ended.cells.simulated < first.cells.simulated
    least = min(row.individual for row in rows_of(database, ended) if row.outcome is Outcome.PREDICTED and row.iteration == 0)
    assert least < slice_size(400), "the first batch waits for no answer of its own"
    best = Cell(1, present(ended.best).parameters)
    assert present(ended.best).scores == {name: slowly(name, best).score for name in ("S1", "S2")}


@pytest.mark.slow
def test_the_account_has_what_predictions_saved_and_what_they_cost(api: RunningApi) -> None:
    wanted = {
        "parameters": SPACE,
        "catalogue": ["S1", "S2"],
        "optimizer": {"kind": "genetic", "population": 400, "iterations": 4, "seed": 3},
        "reduction": {"mode": "predicted", "tolerance": 0.0, "limit": 0.05},
        "sensitivity": None,
    }
    path = f"/api/v1/campaigns/{run_posted(api, wanted, ComputedBackend(answer=slowly))}"
    campaign = Campaign.model_validate(api.http.get(path).json())
    account = Accounting.model_validate(api.http.get(campaign.links["results"]).json()["accounting"])
    assert sum(scenario.predicted for scenario in account.scenarios) == campaign.cells.predicted
    balance = {item.name: item.seconds for item in account.balance}
    assert balance["predicted"] > 0
    assert balance["predictor"] == pytest.approx(-sum(lots.seconds for lots in campaign.released.values()))
    assert balance["dispatcher"] < 0, "look-ups, planning, and loading the predictors"
    assert account.net_seconds == pytest.approx(sum(balance.values()))

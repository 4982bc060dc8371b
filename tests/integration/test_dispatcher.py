"""Whole campaigns through database and dispatcher, with a formula in the place of the simulation."""

import threading
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest
from sqlalchemy import select
from tests.support.computed import ComputedBackend, computed
from tests.support.databases import migrated
from tests.support.problems import store, submit_checked
from tests.support.runs import SMALL, dispatcher, everything, finish, get, request, rows_of, submit
from tests.support.values import present

from drivecal.api.responses import campaign_answer
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.campaigns.resolve.workbench import installed_bundles
from drivecal.campaigns.results.front import StoredRanking
from drivecal.campaigns.stages import leader
from drivecal.contracts.specification import EvaluationSpecification
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.evaluations import Breakdown
from drivecal.plugins import registry
from drivecal.storage import campaigns, generations
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.tables import runs
from drivecal.storage.engine.types import now


def _get(database: Database, campaign: StoredCampaign) -> StoredCampaign:
    result = get(database, campaign)
    counts = result.cells
    assert counts.proposed == counts.carried_over + counts.pending + counts.requested
    answered = counts.repeated + counts.reused + counts.simulated + counts.failed
    assert counts.requested == answered
    assert counts.audited <= counts.simulated
    return result


def _run(database: Database, campaign: StoredCampaign, backend: ComputedBackend | None = None) -> StoredCampaign:
    return _get(database, finish(database, campaign, dispatcher(database, backend)))


def test_a_campaign_runs_to_its_end_and_every_cell_has_its_answer(database: Database) -> None:
    ended = _run(database, submit(database))
    assert ended.state is CampaignState.SUCCEEDED
    assert ended.cells.pending == 0
    assert ended.cells.proposed == 24 * 3 * 6
    assert ended.cells.reused == ended.cells.failed == 0
    assert ended.best is not None
    assert ended.best.alternatives >= 1
    with database.read() as connection:
        figures, _ = generations.page(connection, ended.sequence)
    assert len(rows_of(database, ended)) == ended.cells.requested
    assert sum(each.simulated for each in figures) == ended.cells.simulated
    best = max(each.best or 0 for each in figures)
    assert best == ended.best.objective


def test_a_rerun_with_other_weights_and_the_same_seed_is_answered_mostly_from_the_table(database: Database) -> None:
    first = _run(database, submit(database))
    again = _run(database, submit(database))
    assert again.cells.simulated == 0
    assert again.cells.repeated == again.cells.requested
    assert again.best == first.best
    other = _run(database, submit(database, weights={"S1": 5}))
    assert other.cells.repeated > 0
    assert other.cells.simulated < first.cells.simulated
    with database.read() as connection:
        keys = connection.execute(select(runs.c.setup_id, runs.c.parameter_set_id)).all()
    assert len(keys) == len(set(keys)) == first.cells.simulated + other.cells.simulated


def test_pause_stops_the_work_and_resume_goes_on_to_the_same_result(tmp_path: Path) -> None:
    result = []
    for pauses in (False, True):
        database = migrated(f"sqlite:///{tmp_path / str(pauses)}.db")
        campaign = submit(database)
        backend = ComputedBackend()
        working = dispatcher(database, backend)
        if pauses:
            for _ in range(7):
                working.step()
            request(database, campaign, "pause")
            while _get(database, campaign).state is not CampaignState.PAUSED:
                working.step()
            sent = len(backend.sent)
            for _ in range(20):
                working.step()
            assert len(backend.sent) == sent
            assert not _get(database, campaign).state.ended
            request(database, campaign, "resume")
        while not _get(database, campaign).state.ended:
            working.step()
        result.append(everything(database, campaign))
    assert result[0] == result[1]


def test_a_stop_stores_the_results_that_have_come(database: Database) -> None:
    campaign, backend, stop = submit(database), ComputedBackend(), threading.Event()
    working = dispatcher(database, backend)
    while _get(database, campaign).cells.simulated < 50:
        working.step()
    stop.set()
    sent = len(backend.sent)
    for _ in range(30):  # in each, some more come
        working.run(stop)
    assert _get(database, campaign).cells.simulated == len(backend.sent) == sent


@pytest.mark.parametrize("paused", [False, True])
def test_cancel_ends_the_campaign_and_keeps_what_was_finished(database: Database, *, paused: bool) -> None:
    campaign = submit(database)
    working = dispatcher(database, ComputedBackend())
    while _get(database, campaign).cells.simulated < 50:
        working.step()
    if paused:
        request(database, campaign, "pause")
        while _get(database, campaign).state is not CampaignState.PAUSED:
            working.step()
    request(database, campaign, "cancel")
    while not _get(database, campaign).state.ended:
        working.step()
    ended = _get(database, campaign)
    assert ended.state is CampaignState.CANCELLED
    assert ended.cells.simulated >= 50
    best = present(StoredRanking.of(database, ended).sets.best())[0]
    assert present(ended.best).objective == best.objective  # of a generation that was not closed
    again = _run(database, submit(database))
    assert again.cells.repeated >= ended.cells.simulated


def test_a_fault_in_the_best_set_of_a_campaign_ends_this_one_alone(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(leader.Leader, "describe", Mock(side_effect=ValueError("a bug")))
    ended = _run(database, submit(database))
    assert (ended.state, "a bug" in str(ended.error), ended.best) == (CampaignState.FAILED, True, None)


def test_a_single_evaluation_without_a_result_in_a_scenario_has_failed(database: Database) -> None:
    def broken(scenario: str, cell: Cell) -> CellResult:
        result = computed(scenario, cell)
        return replace(result, breakdown=Breakdown.CRASH.value, detail="exit code 7") if scenario == "S2" else result

    specification = EvaluationSpecification(parameters={f"P{i}": 0.5 for i in range(1, 12)})
    with database.transaction() as connection:
        campaign = campaigns.insert(connection, name="one", spec=specification.model_dump(mode="json"), kind="evaluation")
    ended = _run(database, campaign, ComputedBackend(answer=broken))
    assert (ended.state, ended.cells.failed, ended.cells.simulated) == (CampaignState.FAILED, 1, 5)
    assert "exit code 7" in str(ended.error)


def test_a_campaign_that_cannot_be_resolved_any_more_fails_and_says_why(database: Database) -> None:
    campaign = submit(database)
    document = dict(campaign.spec) | {"driving_function": "uninstalled"}
    with database.transaction() as connection:
        broken = campaigns.insert(connection, name="broken", spec=document)
    ended = _run(database, broken)
    assert ended.state is CampaignState.FAILED
    assert "uninstalled" in str(ended.error)
    assert _run(database, campaign).state is CampaignState.SUCCEEDED


def test_a_queued_problem_has_its_scale_and_takes_new_versions(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    own = installed_bundles("highway")
    cost = {"formula": "peak_lateral_jerk_mps3", "direction": "minimise", "range": [0, 100], "failed": 200}
    store(database, own.manifest.model_dump(mode="json") | {"problem": "mine", "scores": {"cost": cost}})
    queued = submit_checked(database, SMALL | {"problem": "mine"})
    scale = campaign_answer(queued, now(), None).scale
    assert scale == resolved_spec(queued).scale
    assert (scale.direction, scale.failed) == ("minimise", 200)
    monkeypatch.setattr(type(registry.driving_function("frenet")), "version", "another")
    working = dispatcher(database, ComputedBackend())
    while not (begun := _get(database, queued)).stages:
        working.step()
    assert resolved_spec(begun).setups != resolved_spec(queued).setups
    monkeypatch.setattr(type(registry.driving_function("frenet")), "version", "a third")
    assert "another version" in str(_run(database, begun).error)

"""Requests that overtake each other, versions that change, databases that do not answer: a campaign ends as it should all the same."""

import re
import time
from collections import Counter
from types import SimpleNamespace
from typing import Any

import pytest
from tests.support.computed import ComputedBackend
from tests.support.deaths import mortal
from tests.support.runs import EXPERT_SPACE, dispatcher, finish, get, request, rows_of, submit
from tests.support.values import present

from drivecal.campaigns.resolve.maps import resolve_map
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.stages import search as searches
from drivecal.contracts.specification import EvaluationSpecification, Given, InfluenceMapSpecification
from drivecal.contracts.work import Cell, CellResult
from drivecal.dispatch.dispatcher import Dispatcher
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.errors import UnavailableError
from drivecal.domain.evaluations import Outcome
from drivecal.storage import campaigns, generations, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import influence_maps

SEARCH: dict[str, Any] = {"kind": "genetic", "population": 24, "iterations": 5, "seed": 3}


def _submit(database: Database, **changes: Any) -> StoredCampaign:
    return submit(database, **{"catalogue": ["S1", "S2"], "optimizer": SEARCH} | changes)


def _busy(database: Database) -> tuple[StoredCampaign, ComputedBackend, Dispatcher]:
    """A running campaign whose cells are at workers that do not answer for now."""
    campaign, backend = _submit(database), ComputedBackend()
    working = dispatcher(database, backend)
    for _ in range(4):
        working.step()
    backend.held = True
    working.step()
    return campaign, backend, working


def test_a_cancel_overtakes_a_pause_that_still_waits_for_workers(database: Database) -> None:
    campaign, backend, working = _busy(database)
    request(database, campaign, "pause")
    working.step()
    request(database, campaign, "cancel")
    working.step()
    backend.held = False
    assert finish(database, campaign, working).state is CampaignState.CANCELLED


def test_a_cancelled_campaign_that_is_taken_up_again_asks_for_nothing_more(database: Database) -> None:
    campaign, _, _ = _busy(database)
    request(database, campaign, "cancel")
    before = get(database, campaign).cells.proposed
    fresh = ComputedBackend()
    ended = finish(database, campaign, dispatcher(database, fresh))
    assert (ended.state, ended.cells.proposed, fresh.sent) == (CampaignState.CANCELLED, before, [])


def test_a_pause_whose_answer_is_lost_simulates_nothing_more_until_it_is_resumed(database: Database) -> None:
    campaign, backend, lost = _submit(database, optimizer=SEARCH | {"iterations": 2}), ComputedBackend(), list[bool]()

    def loses() -> bool:
        """The answer to the commit of the pause is lost."""
        if lost or get(database, campaign).state is not CampaignState.PAUSED:
            return False
        lost.append(True)
        return True

    working = mortal(database, loses, backend, UnavailableError)
    for _ in range(4):
        working.step()
    request(database, campaign, "pause")
    with pytest.raises(UnavailableError):
        finish(database, campaign, working)
    working._forget_jobs()  # as `Dispatcher.run` does
    sent = len(backend.sent)
    for _ in range(5):
        working.step()
    assert (get(database, campaign).state, len(backend.sent), working._active) == (CampaignState.PAUSED, sent, {})
    request(database, campaign, "resume")
    assert finish(database, campaign, working).state is CampaignState.SUCCEEDED
    assert max(Counter(backend.sent).values()) == 1


@pytest.mark.parametrize("part", ["setups", "evaluator", "space"])
def test_a_campaign_does_not_go_on_with_another_version(database: Database, part: str, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign, _, _ = _busy(database)
    begun_with = CalibrationProblem.resolution
    monkeypatch.setattr(CalibrationProblem, "resolution", lambda problem: begun_with(problem) | {part: "another one"})
    ended = finish(database, campaign, dispatcher(database, ComputedBackend()))
    assert ended.state is CampaignState.FAILED
    assert part in str(ended.error)


def test_a_run_outside_the_space_of_a_map_answers_nothing_inside_it(database: Database) -> None:
    def outside_is_bad(scenario: str, cell: Cell) -> CellResult:
        del scenario
        rating = 0.0 if cell.parameters["P9"] > 1 else 6.0
        return CellResult(cell.id, rating, round(rating), {}, None, 7.0)

    middle: dict[str, Given] = {f"P{i}": 0.5 for i in range(1, 12)}
    single = EvaluationSpecification(parameters=middle | {"P9": 1000.0})
    document = {"scenarios": {"S1": {"P9": {"influential": False}}, "S2": {"P9": {"upper": 0}}}}
    posted = InfluenceMapSpecification.model_validate(document | {"parameters": EXPERT_SPACE})
    with database.transaction() as connection:
        campaigns.insert(connection, name="one", spec=single.model_dump(mode="json"), kind="evaluation")
        stored = influence_maps.insert(connection, **resolve_map(posted))
    working = dispatcher(database, ComputedBackend(answer=outside_is_bad))
    for _ in range(60):
        working.step()
    ended = finish(database, _submit(database, stored_map=stored.id, baseline=middle), working)
    assert present(ended.baseline).scores == {"S1": 6, "S2": 6}
    assert ended.cells.reused > 0


def test_simulations_that_do_not_repeat_themselves_are_told(database: Database) -> None:
    def drifting(scenario: str, cell: Cell) -> CellResult:
        del scenario
        return CellResult(cell.id, 3.0, 3, {"draw": float(cell.id)}, None, 7.0)

    finish(database, _submit(database), dispatcher(database, ComputedBackend(answer=drifting)))
    again = _submit(database, reduction={"mode": "off"})
    first = dispatcher(database, ComputedBackend(answer=drifting))
    for _ in range(6):
        first.step()
    ended = finish(database, again, dispatcher(database, ComputedBackend(answer=drifting)))
    repeated = [row for row in rows_of(database, ended) if not row.has_seed]
    assert ended.cells.unrepeatable == len(repeated) < ended.cells.simulated, "runs under further seeds repeat no run"
    assert any(str(ended.cells.unrepeatable) in re.findall(r"\d+", note) for note in ended.notes)
    with database.read() as connection:
        cells = results.answers(
            connection, ended.sequence, StageName.CALIBRATION, valued=lambda metrics, *_: {"draw": metrics["draw"] or 0.0}
        )
        drawn = {(cell.iteration, cell.individual, cell.scenario): cell.values["draw"] for cell in cells if cell.seed == 1}
    own = [row for row in repeated if row.outcome == Outcome.SIMULATED]
    assert [drawn[row.iteration, row.individual, row.scenario] for row in own] == [row.id for row in own], "of its own run"


@pytest.mark.parametrize(("pauses", "end"), [(True, "iterations"), (False, "budget")])
def test_a_pause_takes_no_minutes(database: Database, monkeypatch: pytest.MonkeyPatch, pauses: bool, end: str) -> None:
    campaign, working = _submit(database, budget={"minutes": 60}), dispatcher(database)
    while not get(database, campaign).cells.simulated:
        working.step()
    if pauses:
        request(database, campaign, "pause")
        while get(database, campaign).state is not CampaignState.PAUSED:
            working.step()
        request(database, campaign, "resume")
    later = time.monotonic() + 36_000.0
    monkeypatch.setattr(searches, "time", SimpleNamespace(monotonic=lambda: later))
    search = present(finish(database, campaign, working).search)
    assert search.ended_by == end


def test_minutes_end_within_a_large_generation_and_begin_with_the_first_run(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(searches, "time", SimpleNamespace(monotonic=lambda: clock.now))
    backend = ComputedBackend(held=True)
    campaign = _submit(database, budget={"minutes": 60}, optimizer={"kind": "genetic", "population": 60, "iterations": 2})
    working = dispatcher(database, backend)
    for _ in range(5):
        working.step()
    backend.held, clock.now = False, 36_000.0  # the workers have started
    while not get(database, campaign).cells.simulated:
        working.step()
    clock.now += 36_000.0
    ended = finish(database, campaign, working)
    assert (present(ended.search).ended_by, ended.best is not None) == ("budget", True)
    assert 0 < ended.cells.requested < 2 * 60


def test_populations_end_with_the_one_after_which_the_search_has_stood_still(database: Database) -> None:
    ended = finish(
        database,
        _submit(database, budget={"stagnation": 30}, optimizer={"kind": "random", "population": 10}),
        dispatcher(database),
    )
    search = present(ended.search)
    assert search.ended_by == "stagnation"
    with database.read() as connection:
        assert search.stood_still_at == generations.finished(connection, ended.sequence)

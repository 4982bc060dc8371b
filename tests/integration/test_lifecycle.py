"""Requests that overtake each other, versions that change, databases that do not answer: a campaign ends as it should all the same."""

import re
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import Any

import pytest
from sqlalchemy import Connection
from tests.support.computed import ComputedBackend
from tests.support.runs import finish, get, request, rows_of

from drivecal.campaigns.resolve.maps import resolve_map
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.stages import search as searches
from drivecal.contracts.specification import CampaignSpecification, EvaluationSpecification, Given, InfluenceMapSpecification
from drivecal.contracts.work import Cell, CellResult
from drivecal.dispatch.dispatcher import Dispatcher
from drivecal.dispatch.heartbeat import Leadership
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.errors import UnavailableError
from drivecal.domain.evaluations import Outcome
from drivecal.execution.pool import Leases, WorkPool
from drivecal.storage import campaigns, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.references import influence_maps

SPECIFICATION: dict[str, Any] = {
    "sensitivity": None,
    "parameters": [{"name": f"P{i}", "lower": 0, "upper": 1, "step": 0.5} for i in range(1, 12)],
    "catalogue": ["S1", "S2"],
    "optimizer": {"kind": "genetic", "population": 24, "iterations": 5, "seed": 3},
}


class HeldBackend(ComputedBackend):
    """Gives nothing back while it is held."""

    held = False

    def wait(self, timeout: float) -> list[Any]:
        return [] if self.held else super().wait(timeout)


def _submit(database: Database, **changes: Any) -> StoredCampaign:
    specification = CampaignSpecification.model_validate(SPECIFICATION | changes)
    named = (specification.model_dump()["sensitivity"] or {}).get("map")
    with database.transaction() as connection:
        return campaigns.insert(connection, name="test", spec=specification.model_dump(mode="json"), influence_map_id=named)


def _dispatcher(database: Database, backend: ComputedBackend) -> Dispatcher:
    """A newly elected one."""
    Leadership.begin(database)
    ticks = iter(range(10**9))
    return Dispatcher(database, WorkPool(backend, Leases(database)), clock=lambda: float(next(ticks)))


def _busy(database: Database) -> tuple[StoredCampaign, HeldBackend, Dispatcher]:
    """A running campaign whose cells are at workers that do not answer for now."""
    campaign, backend = _submit(database), HeldBackend()
    dispatcher = _dispatcher(database, backend)
    for _ in range(4):
        dispatcher.step()
    backend.held = True
    dispatcher.step()
    return campaign, backend, dispatcher


def test_a_cancel_overtakes_a_pause_that_still_waits_for_workers(database: Database) -> None:
    campaign, backend, dispatcher = _busy(database)
    request(database, campaign, "pause")
    dispatcher.step()
    request(database, campaign, "cancel")
    dispatcher.step()
    backend.held = False
    assert finish(database, campaign, dispatcher).state is CampaignState.CANCELLED


def test_a_cancelled_campaign_that_is_taken_up_again_asks_for_nothing_more(database: Database) -> None:
    campaign, _, _ = _busy(database)
    request(database, campaign, "cancel")
    before = get(database, campaign).cells.proposed
    fresh = ComputedBackend()
    ended = finish(database, campaign, _dispatcher(database, fresh))
    assert (ended.state, ended.cells.proposed, fresh.sent) == (CampaignState.CANCELLED, before, [])


class _LostAnswer:
    """A database that commits the transaction that brings a campaign into `state`, and whose answer to that commit is lost."""

    def __init__(self, database: Database, campaign: StoredCampaign, state: CampaignState) -> None:
        self._database, self._campaign, self._state = database, campaign, state
        self.is_lost = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._database, name)

    @contextmanager
    def transaction(self) -> Iterator[Connection]:
        with self._database.transaction() as connection:
            yield connection
        if not self.is_lost and get(self._database, self._campaign).state is self._state:
            self.is_lost = True
            raise UnavailableError("the answer to the commit was lost")


def _lose_the_answer(used: _LostAnswer, dispatcher: Dispatcher) -> None:
    """Works until the answer is lost, and does then as `Dispatcher.run` does."""
    for _ in range(200):
        try:
            dispatcher.step()
        except UnavailableError:
            dispatcher._forget_jobs()
            break
    assert used.is_lost


def test_a_pause_whose_answer_is_lost_simulates_nothing_more_until_it_is_resumed(database: Database) -> None:
    campaign, backend = _submit(database, optimizer=SPECIFICATION["optimizer"] | {"iterations": 2}), ComputedBackend()
    used: Any = _LostAnswer(database, campaign, CampaignState.PAUSED)
    dispatcher = _dispatcher(used, backend)
    for _ in range(4):
        dispatcher.step()
    request(database, campaign, "pause")
    _lose_the_answer(used, dispatcher)
    sent = len(backend.sent)
    for _ in range(5):
        dispatcher.step()
    assert (get(database, campaign).state, len(backend.sent), dispatcher._active) == (CampaignState.PAUSED, sent, {})
    request(database, campaign, "resume")
    assert finish(database, campaign, dispatcher).state is CampaignState.SUCCEEDED
    assert max(Counter(backend.sent).values()) == 1


@pytest.mark.parametrize("part", ["setups", "evaluator", "space"])
def test_a_campaign_does_not_go_on_with_another_version(database: Database, part: str, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign, _, _ = _busy(database)
    begun_with = CalibrationProblem.resolution
    monkeypatch.setattr(CalibrationProblem, "resolution", lambda problem: begun_with(problem) | {part: "another one"})
    ended = finish(database, campaign, _dispatcher(database, ComputedBackend()))
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
    posted = InfluenceMapSpecification.model_validate(document | {"parameters": SPECIFICATION["parameters"]})
    with database.transaction() as connection:
        campaigns.insert(connection, name="one", spec=single.model_dump(mode="json"), kind="evaluation")
        stored = influence_maps.insert(connection, **resolve_map(posted))
    no_lots = {"mode": "influence", "max_error": 1}  # so few answers would all be in the sample
    dispatcher = _dispatcher(database, ComputedBackend(answer=outside_is_bad))
    for _ in range(60):
        dispatcher.step()
    ended = finish(database, _submit(database, sensitivity={"map": stored.id}, reduction=no_lots, baseline=middle), dispatcher)
    assert ended.baseline is not None
    assert ended.baseline.scores == {"S1": 6, "S2": 6}
    assert ended.cells.reused > 0


def test_simulations_that_do_not_repeat_themselves_are_told(database: Database) -> None:
    def drifting(scenario: str, cell: Cell) -> CellResult:
        del scenario
        return CellResult(cell.id, 3.0, 3, {"draw": float(cell.id)}, None, 7.0)

    finish(database, _submit(database), _dispatcher(database, ComputedBackend(answer=drifting)))
    again = _submit(database, reduction={"mode": "off"})
    first = _dispatcher(database, ComputedBackend(answer=drifting))
    for _ in range(6):
        first.step()
    ended = finish(database, again, _dispatcher(database, ComputedBackend(answer=drifting)))
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


def test_a_pause_takes_no_minutes_of_a_budget(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign, dispatcher = _submit(database, budget={"minutes": 60}), _dispatcher(database, ComputedBackend())
    while not get(database, campaign).cells.simulated:
        dispatcher.step()
    request(database, campaign, "pause")
    while get(database, campaign).state is not CampaignState.PAUSED:
        dispatcher.step()
    later = now() + timedelta(hours=10)
    monkeypatch.setattr(searches, "now", lambda: later)
    request(database, campaign, "resume")
    search = finish(database, campaign, dispatcher).search
    assert search is not None
    assert search.ended_by == "iterations"

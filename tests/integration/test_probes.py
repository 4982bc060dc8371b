"""Versions of tools outside of a bundle belong to its results: campaigns, evaluations, comparisons and restarts."""

from typing import Any

import pytest
from tests.support.fake_backend import FakeBackend
from tests.support.problems import RANDOM, scored, store, submit_checked
from tests.support.runs import finish, get, request, rows_of

from drivecal.dispatch.dispatcher import Dispatcher
from drivecal.dispatch.heartbeat import Leadership
from drivecal.domain.campaigns import CampaignState
from drivecal.execution.pool import Leases, WorkPool
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database

MANIFEST = scored("mine", {"value": {"lower": 0, "upper": 100}}, series={"v": "1"}) | {
    "simulator": {"kind": "process", "command": ["mysim"], "probe": ["mysim", "--version"], "deterministic": True},
    "measures": {"value": "1"},
    "scores": {"best": {"formula": "value", "direction": "maximise", "range": [0, 100]}},
}
SPEC = RANDOM | {"optimizer": {"kind": "random", "population": 10, "iterations": 2, "seed": 1}}
CELLS = 26
"""Requested cells of such a campaign."""


@pytest.fixture(autouse=True)
def _pushed(database: Database) -> None:
    store(database, MANIFEST)


def submit(database: Database, **changes: Any) -> StoredCampaign:
    return submit_checked(database, SPEC | changes)


def dispatcher(database: Database, backend: FakeBackend) -> Dispatcher:
    own = database.fenced(Leadership.begin(database).fence)
    return Dispatcher(own, WorkPool(backend, Leases(own), clock=lambda: backend.now), clock=lambda: backend.now)


def ended(database: Database, campaign: StoredCampaign, backend: FakeBackend | None = None) -> StoredCampaign:
    return finish(database, campaign, dispatcher(database, backend or FakeBackend()))


def begin(database: Database, campaign: StoredCampaign, working: Dispatcher) -> StoredCampaign:
    """Works until a cell of a campaign was simulated."""
    for _ in range(1_000):
        working.step()
        if (begun := get(database, campaign)).cells.simulated:
            return begun
    raise AssertionError("no cell was simulated")


def on(version: str) -> FakeBackend:
    return FakeBackend(tools={1: version, 2: version})


def test_results_of_other_tools_never_answer(database: Database) -> None:
    first = ended(database, submit(database), on("1.0"))
    assert (first.state, first.cells.simulated) == (CampaignState.SUCCEEDED, CELLS)
    assert any("1.0" in note for note in first.notes)
    assert ended(database, submit(database), on("1.0")).cells.repeated == CELLS
    assert ended(database, submit(database), on("2.0")).cells.simulated == CELLS
    assert ended(database, submit(database), on("2.0")).cells.repeated == CELLS
    assert ended(database, submit(database), on("1.0")).cells.repeated == CELLS


def test_a_campaign_keeps_its_answer_over_restarts(database: Database) -> None:
    campaign = submit(database)
    begin(database, campaign, dispatcher(database, on("1.0")))
    restarted = ended(database, campaign, FakeBackend(tools={1: "2.0", 2: "1.0"}))
    assert (restarted.state, restarted.cells.simulated) == (CampaignState.SUCCEEDED, CELLS)
    assert len({row.setup_id for row in rows_of(database, campaign)}) == 2


def test_a_campaign_whose_tools_are_gone_ends_with_both_answers(database: Database) -> None:
    campaign = submit(database)
    begin(database, campaign, dispatcher(database, on("1.0")))
    failed = ended(database, campaign, on("2.0"))
    assert failed.state is CampaignState.FAILED
    assert "1.0" in (failed.error or "")
    assert "2.0" in (failed.error or "")


def test_a_cancelled_campaign_does_not_wait_for_an_answer(database: Database) -> None:
    campaign = submit(database)
    running = dispatcher(database, FakeBackend(refusing={1: "no mysim", 2: "no mysim"}))
    for _ in range(20):
        running.step()
    request(database, campaign, "cancel")
    for _ in range(50):
        running.step()
    assert get(database, campaign).state is CampaignState.CANCELLED


def test_a_map_holds_for_the_tools_that_it_was_made_with(database: Database) -> None:
    analysis = {"intervals": 3, "samples": 4, "threshold": 0.02}
    made = ended(database, submit(database, sensitivity=analysis), on("1.0"))
    assert made.influence_map_id is not None
    named = {"sensitivity": {"map": made.influence_map_id}, "reduction": {"mode": "influence"}}
    assert ended(database, submit(database, **named), on("1.0")).state is CampaignState.SUCCEEDED
    other = ended(database, submit(database, **named), on("2.0"))
    assert other.state is CampaignState.FAILED
    assert "map" in (other.error or "")

"""Searches that another process resumes: a replay that proposes otherwise, and what other writers notice of a restore."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select
from tests.support.databases import migrated
from tests.support.runs import dispatcher, everything, finish, get, submit

from drivecal.dispatch.heartbeat import Leadership
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import SupersededError
from drivecal.optimizers import optuna_samplers
from drivecal.optimizers.optuna_samplers import OPTUNA, OptunaSettings
from drivecal.storage import campaigns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database, Patience
from drivecal.storage.engine.tables import evaluations, generations
from drivecal.storage.maintenance.consistency import INVARIANTS

SEARCH = {"kind": "optuna", "sampler": "random", "population": 8, "iterations": 6, "seed": 3}
IMPATIENT = Patience(lock=0.05, connect=1, statement=None, watched=False)


def _rows(database: Database, campaign: StoredCampaign) -> list[Any]:
    """All rows of a campaign's search."""
    with database.read() as connection:
        return [
            list(connection.execute(select(table).where(table.c.campaign_sequence == campaign.sequence)))
            for table in (generations, evaluations)
        ]


def _begun(database: Database, iterations: int) -> StoredCampaign:
    """A campaign whose dispatcher died when that many iterations were under way."""
    campaign = submit(database, optimizer=SEARCH)
    working = dispatcher(database)
    while (get(database, campaign).iteration or 0) < iterations:
        working.step()
    return campaign


def _while_restoring(monkeypatch: pytest.MonkeyPatch, act: Callable[[], None]) -> None:
    """Calls `act` whenever the optimizer is created, restored or told something."""
    for name in ("create", "restore"):
        original = getattr(OPTUNA, name)

        def wrapped(*arguments: Any, original: Callable[..., Any] = original) -> Any:
            act()
            return original(*arguments)

        monkeypatch.setattr(OPTUNA, name, wrapped)
    learn = optuna_samplers.OptunaEngine.learn

    def learning(*arguments: Any) -> None:
        act()
        learn(*arguments)

    monkeypatch.setattr(optuna_samplers.OptunaEngine, "learn", learning)


@pytest.mark.slow
def test_an_engine_that_draws_otherwise_ends_the_campaign_and_changes_no_row(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign = _begun(database, 3)
    before, sampler = _rows(database, campaign), optuna_samplers._sampler
    monkeypatch.setattr(
        optuna_samplers,
        "_sampler",
        lambda settings: sampler(OptunaSettings(**(settings.model_dump() | {"seed": settings.seed + 1}))),
    )
    ended = finish(database, campaign, dispatcher(database))
    assert ended.state is CampaignState.FAILED
    assert "iteration 1" in str(ended.error)
    assert _rows(database, campaign) == before
    with database.read() as connection:
        assert [problem for check in INVARIANTS.values() for problem in check(connection)] == []


def test_others_can_write_while_a_search_is_restored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    url = f"sqlite:///{tmp_path / 'drivecal.db'}"
    database, other = Database.open(url), Database.open(url, IMPATIENT)
    database.upgrade()
    writes = list[int]()

    def write() -> None:
        with other.transaction() as connection:
            campaigns.start(connection, -1)
        writes.append(1)

    _while_restoring(monkeypatch, write)
    campaign = _begun(database, 3)
    created = len(writes)
    assert created > 0
    assert finish(database, campaign, dispatcher(database)).state is CampaignState.SUCCEEDED
    assert len(writes) > created
    for opened in (database, other):
        opened.dispose()


def test_a_dispatcher_that_lost_its_leadership_during_a_restore_writes_nothing(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign = _begun(database, 3)
    before = _rows(database, campaign), get(database, campaign)
    superseded = dispatcher(database)

    def elect_another() -> None:
        Leadership.begin(database)

    with monkeypatch.context() as patched:
        _while_restoring(patched, elect_another)
        with pytest.raises(SupersededError):
            finish(database, campaign, superseded)
    assert (_rows(database, campaign), get(database, campaign)) == before


def test_a_search_that_was_resumed_ends_as_one_that_was_not(tmp_path: Path) -> None:
    found = []
    for name in ("whole", "resumed"):
        database = migrated(f"sqlite:///{tmp_path / name}.db")
        campaign = _begun(database, 3) if name == "resumed" else submit(database, optimizer=SEARCH)
        finish(database, campaign, dispatcher(database))
        found.append(everything(database, campaign))
        database.dispose()
    assert found[0] == found[1]

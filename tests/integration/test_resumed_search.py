"""Searches that another process resumes: what other writers notice of a restore."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select
from tests.support.runs import dispatcher, finish, get, submit

from drivecal.dispatch.heartbeat import Leadership
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import SupersededError
from drivecal.optimizers.built_in import SWARM
from drivecal.optimizers.swarm import ParticleSwarm
from drivecal.storage import campaigns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database, Patience
from drivecal.storage.engine.tables import evaluations, generations

SEARCH = {"kind": "swarm", "population": 8, "iterations": 6, "seed": 3}
IMPATIENT = Patience(lock=0.05, connect=1, statement=None)


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


def _while_restoring(monkeypatch: pytest.MonkeyPatch, act: Callable[[], object]) -> None:
    """Calls `act` whenever the optimizer is created, restored or told something."""
    for name in ("create", "restore"):
        original = getattr(SWARM, name)

        def wrapped(*arguments: Any, original: Callable[..., Any] = original) -> Any:
            act()
            return original(*arguments)

        monkeypatch.setattr(SWARM, name, wrapped)
    learn = ParticleSwarm.tell

    def learning(*arguments: Any) -> None:
        act()
        learn(*arguments)

    monkeypatch.setattr(ParticleSwarm, "tell", learning)


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_dispatcher_superseded_during_a_restore_writes_nothing(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = _begun(database, 3)
    before = _rows(database, campaign), get(database, campaign)
    superseded = dispatcher(database)
    with monkeypatch.context() as patched:
        _while_restoring(patched, lambda: Leadership.begin(database))
        with pytest.raises(SupersededError):
            finish(database, campaign, superseded)
    assert (_rows(database, campaign), get(database, campaign)) == before

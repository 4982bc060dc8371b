"""Optimizers that compute for long: their own campaign waits, and nothing else does."""

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.support.computed import ComputedBackend
from tests.support.databases import migrated
from tests.support.runs import dispatcher, everything, finish, get, request, run, step_until, submit

from drivecal.dispatch.dispatcher import Dispatcher
from drivecal.domain.campaigns import CampaignState
from drivecal.optimizers.population import RandomSearch
from drivecal.plugins.ports import Proposal
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database

SLOW: dict[str, Any] = {"kind": "random", "population": 24, "iterations": 3, "seed": 3}
QUICK: dict[str, Any] = {"kind": "genetic", "population": 24, "iterations": 6, "seed": 3}


class Doors:
    """Every proposal of a random search waits at a door until it is opened."""

    def __init__(self) -> None:
        self.arrived, self.open = threading.Event(), threading.Event()

    def close(self) -> None:
        self.arrived.clear()
        self.open.clear()


@pytest.fixture
def doors(monkeypatch: pytest.MonkeyPatch) -> Iterator[Doors]:
    doors, ask = Doors(), RandomSearch.ask

    def waits(search: RandomSearch) -> Proposal:
        doors.arrived.set()
        doors.open.wait()
        return ask(search)

    monkeypatch.setattr(RandomSearch, "ask", waits)
    yield doors
    doors.open.set()


def thinking(database: Database, doors: Doors, working: Dispatcher, *, iteration: int) -> StoredCampaign:
    """A campaign whose optimizer computes this iteration."""
    campaign = submit(database, optimizer=SLOW)
    if iteration:
        doors.open.set()
        step_until(database, campaign, iteration - 1, working)
        doors.close()
    while not doors.arrived.is_set():
        working.step()
    return campaign


@pytest.mark.parametrize("iteration", [0, 1])
def test_a_campaign_ends_while_the_optimizer_of_another_computes(database: Database, doors: Doors, iteration: int) -> None:
    working = dispatcher(database)
    slow = thinking(database, doors, working, iteration=iteration)
    quick = finish(database, submit(database, optimizer=QUICK), working)
    assert (quick.state, quick.error) == (CampaignState.SUCCEEDED, None)
    assert get(database, slow).state is CampaignState.RUNNING
    doors.open.set()
    assert finish(database, slow, working).error is None


@pytest.mark.parametrize("iteration", [0, 1])
def test_a_campaign_whose_optimizer_computes_is_cancelled(database: Database, doors: Doors, iteration: int) -> None:
    working = dispatcher(database)
    slow = thinking(database, doors, working, iteration=iteration)
    request(database, slow, "cancel")
    assert finish(database, slow, working).state is CampaignState.CANCELLED
    assert not doors.open.is_set()


@pytest.mark.slow("1-pause", "1-death")
@pytest.mark.parametrize("how", ["pause", "death"])
@pytest.mark.parametrize("iteration", [0, 1])
def test_a_stop_while_computing_is_clean(database: Database, doors: Doors, tmp_path: Path, iteration: int, how: str) -> None:
    working = dispatcher(database)
    slow = thinking(database, doors, working, iteration=iteration)
    if how == "pause":
        request(database, slow, "pause")
        while get(database, slow).state is not CampaignState.PAUSED:
            working.step()
        request(database, slow, "resume")
    else:
        working = dispatcher(database)
    assert not doors.open.is_set()
    doors.open.set()
    ended = finish(database, slow, working)
    other = migrated(f"sqlite:///{tmp_path / 'undisturbed.db'}")
    undisturbed = run(other, submit(other, optimizer=SLOW), ComputedBackend())
    assert everything(database, ended) == everything(other, undisturbed)

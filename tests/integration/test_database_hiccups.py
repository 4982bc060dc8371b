"""A database that fails now and then: campaigns end as if it had not, and workers go on."""

import random
from collections import Counter
from typing import Any

import pytest
from tests.support.computed import ComputedBackend
from tests.support.databases import migrated
from tests.support.deaths import InterceptedDatabase
from tests.support.effort import tries
from tests.support.runs import everything, get, post_map, submit

from drivecal.dispatch.dispatcher import Dispatcher
from drivecal.dispatch.heartbeat import Leadership
from drivecal.domain.errors import UnavailableError
from drivecal.execution.pool import Leases, WorkPool
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database

MAP = {
    scenario: {f"P{i}": {"influential": False} for i in range(1, 12) if i not in left}
    for scenario, left in {"S1": (1, 2), "S2": (3, 4)}.items()
}


class ShakyDatabase(InterceptedDatabase):
    """Fails with a probability at each of these moments."""

    def __init__(self, database: Database, draw: random.Random, share: float) -> None:
        super().__init__(database, self._fail_sometimes)
        self._draw, self.share = draw, share
        self.failures = Counter[str]()

    def _fail_sometimes(self, name: str) -> None:
        if self._draw.random() < self.share:
            self.failures[name] += 1
            raise UnavailableError(name)


class Patience:
    """Stops a dispatcher when its campaign has ended, and waits for nothing."""

    def __init__(self, database: Database, campaign: StoredCampaign) -> None:
        self._database, self._campaign = database, campaign
        self._left = 5_000

    def is_set(self) -> bool:
        self._left -= 1
        assert self._left, "the campaign does not end"
        return get(self._database, self._campaign).state.ended

    def wait(self, _seconds: float) -> None:
        pass


def dispatcher(database: Any, backend: ComputedBackend) -> Dispatcher:
    ticks = iter(range(10**9))
    return Dispatcher(database, WorkPool(backend, Leases(database)), clock=lambda: float(next(ticks)))


def shaky(database: Database, seed: int, share: float) -> Any:
    return ShakyDatabase(database.fenced(Leadership.begin(database).fence), random.Random(seed), share)


@pytest.mark.parametrize("seed", range(tries(1, 5)))
def test_hiccups_change_no_result_and_simulate_nothing_twice(tmp_path: Any, seed: int) -> None:
    ended, sent = [], []
    for share in (0.0, 0.1):
        (tmp_path / str(share)).mkdir()
        database = migrated(f"sqlite:///{tmp_path / str(share) / 'drivecal.db'}")
        campaign = submit(
            database,
            stored_map=post_map(database, MAP),
            catalogue=["S1", "S2"],
            optimizer={"kind": "genetic", "population": 8, "iterations": 2, "seed": 3},
            reduction={"audit": 0.2, "confirm": 20},
        )
        own, backend = shaky(database, seed, share), ComputedBackend(seed)
        patience: Any = Patience(database, campaign)
        dispatcher(own, backend).run(patience)
        assert bool(own.failures) == (share > 0)
        ended.append(everything(database, campaign))
        sent.append(Counter(backend.sent))
        database.dispose()
    assert ended[0] == ended[1]
    assert sent[0] == sent[1]

"""Campaigns on workers that are good for nothing: the dispatcher on a real database, the workers in memory."""

import pytest
from tests.support.fake_backend import FakeBackend
from tests.support.problems import scored, store, submit_checked
from tests.support.runs import finish, get, submit

from drivecal.dispatch.dispatcher import Dispatcher
from drivecal.dispatch.heartbeat import Heartbeat, Leadership
from drivecal.domain.campaigns import CampaignState
from drivecal.execution.pool import Leases, WorkPool
from drivecal.storage import processes
from drivecal.storage.engine.database import Database

REASON = "coordinator and worker differ: simulator is libsumo 1.28 at the coordinator and libsumo 1.20 at the worker"


class _Beating(Dispatcher):
    """Its pulse beats with every step."""

    def __init__(self, database: Database, backend: FakeBackend) -> None:
        leadership = Leadership.begin(database)
        own, ticks = database.fenced(leadership.fence), iter(range(10**9))
        self.heartbeat = Heartbeat(own, leadership)
        pool = WorkPool(backend, Leases(own), clock=lambda: backend.now)
        super().__init__(own, pool, self.heartbeat.report, clock=lambda: float(next(ticks)))

    def step(self) -> None:
        super().step()
        self.heartbeat.beat()


@pytest.mark.slow
def test_a_campaign_waits_and_says_why_while_every_worker_has_another_version(database: Database) -> None:
    campaign = submit(database)
    backend = FakeBackend(2, refusing={1: REASON, 2: REASON})
    dispatcher = _Beating(database, backend)
    while not backend.replaced:  # another process plans the first batch, for a while
        dispatcher.step()
    waiting = get(database, campaign)
    assert waiting.state is CampaignState.RUNNING
    assert waiting.cells.failed == 0
    assert waiting.degraded is not None
    assert waiting.degraded.endswith(f"workers refuse S1, S2, S3: {REASON}")
    with database.read() as connection:
        reported = processes.read(connection, "dispatcher")
    assert reported is not None
    assert reported.detail["degraded"] == waiting.degraded
    backend.refusing.clear()
    ended = finish(database, campaign, dispatcher)
    assert (ended.state, ended.cells.failed, ended.degraded) == (CampaignState.SUCCEEDED, 0, None)


PROBLEM = scored("mine", {"value": {"lower": 0, "upper": 100}}, "value", measures={"value": "1"})


def test_a_campaign_whose_problem_no_worker_can_run_fails_at_once_with_the_cause(database: Database) -> None:
    store(database, PROBLEM)
    campaign = submit_checked(database, {"problem": "mine", "sensitivity": None})
    cause = "road.net.xml: there is no edge e9"
    backend = FakeBackend(2, refusing={1: cause, 2: cause}, blaming={1, 2})
    failed = finish(database, campaign, _Beating(database, backend))
    assert failed.state is CampaignState.FAILED
    assert cause in (failed.error or "")
    assert backend.replaced == []
    assert backend.now < 5.0

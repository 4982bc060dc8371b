"""Dispatchers that die at a moment of their choice, and what their campaigns find in spite of it."""

import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any, TypeVar

from sqlalchemy import Connection
from tests.support.computed import ComputedBackend
from tests.support.databases import migrated
from tests.support.runs import dispatcher, finish, run

from drivecal.dispatch.dispatcher import Dispatcher
from drivecal.dispatch.heartbeat import Leadership
from drivecal.execution.pool import Leases, WorkPool
from drivecal.storage import generations
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database

Found = TypeVar("Found")


class Killed(BaseException):
    """The dispatcher's process is gone."""


class InterceptedDatabase:
    """Calls `moment` before a transaction begins, before it is committed, and right after, with the name of that moment."""

    def __init__(self, database: Database, moment: Callable[[str], None]) -> None:
        self._database, self._moment = database, moment

    def __getattr__(self, name: str) -> Any:
        return getattr(self._database, name)

    @contextmanager
    def transaction(self) -> Iterator[Connection]:
        self._moment("before a transaction")
        with self._database.transaction() as connection:
            yield connection
            self._moment("before a commit")
        self._moment("after a commit")


def mortal(
    database: Database, dies: Callable[[], bool], backend: ComputedBackend, fault: type[BaseException] = Killed
) -> Dispatcher:
    """Returns a newly elected dispatcher that is killed, or meets another `fault`, when `dies` returns True."""

    def moment(name: str) -> None:
        if dies():
            raise fault(name)

    own: Any = InterceptedDatabase(database.fenced(Leadership.begin(database).fence), moment)
    ticks = iter(range(10**9))
    return Dispatcher(own, WorkPool(backend, Leases(own)), clock=lambda: float(next(ticks)))


def at(moment: int) -> Callable[[], bool]:
    """Returns a function that is true at the given call only, counted from 1."""
    moments = count(1)
    return lambda: next(moments) == moment


def live(database: Database, campaign: StoredCampaign, working: Dispatcher) -> bool:
    """Works until the campaign ends or the dispatcher is killed. Returns whether it was killed."""
    try:
        finish(database, campaign, working)
    except Killed:
        return True
    return False


def killed_between_rounds(
    database: Database,
    campaign: StoredCampaign,
    rounds: Iterable[int],
    backend: Callable[[], ComputedBackend] = ComputedBackend,
) -> None:
    """Carries a campaign out. For each number, a dispatcher dies right after that round was stored as finished, counted from 1."""
    for number in rounds:

        def dies(number: int = number) -> bool:
            with database.read() as connection:
                return generations.finished(connection, campaign.sequence) >= number

        assert live(database, campaign, mortal(database, dies, backend())), f"it ended before {number} rounds"
    finish(database, campaign, dispatcher(database, backend()))


def ends_in_spite_of_deaths(
    folder: Path,
    begin: Callable[[Database], StoredCampaign],
    backend: Callable[[int], ComputedBackend],
    find: Callable[[Database, StoredCampaign], Found],
    stride: int,
) -> list[Found]:
    """Returns the campaign's results, once for each dispatcher that continues from the state after `begin`. The first dispatcher lives.
    Each further one dies `stride` moments later than the last, and a successor finishes. The last one finishes before its death.

    `backend` gets the number of the moment and may order its answers by it.
    """
    used, kept = folder / "used.db", folder / "kept.db"
    database = migrated(f"sqlite:///{used}")
    campaign = begin(database)
    database.dispose()
    shutil.copy(used, kept)
    ends: list[Found] = []
    killed = True
    while killed:
        shutil.copy(kept, used)
        database = migrated(f"sqlite:///{used}")
        moment = stride * len(ends)  # at 0 it lives
        killed = live(database, campaign, mortal(database, at(moment), backend(moment)))
        if killed:
            run(database, campaign, backend(0))
        ends.append(find(database, campaign))
        killed = killed or len(ends) == 1
        database.dispose()
    return ends

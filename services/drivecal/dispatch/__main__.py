"""Runs the dispatcher alone: `python -m drivecal.dispatch`, with the settings of `DRIVECAL_*`. `drivecal serve` starts it with the API, and
gives it the number of its own process, which messages name as the server."""

import gc
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import TypeVar

from drivecal.bundles.installed import installed
from drivecal.campaigns.resolve.problem import trial
from drivecal.cluster import pulse
from drivecal.configuration import logs, memory
from drivecal.configuration.settings import Settings, load_settings
from drivecal.dispatch.dispatcher import Dispatcher
from drivecal.dispatch.heartbeat import STARTING, Heartbeat, Leadership
from drivecal.dispatch.webhook import Webhook
from drivecal.domain.errors import DrivecalError, UnavailableError
from drivecal.execution.backend import BackendLostError
from drivecal.execution.pool import Leases, WorkPool
from drivecal.execution.scheduling.resources import Resources
from drivecal.execution.supervised import SupervisedBackend, WorkerLimits
from drivecal.storage import bundles
from drivecal.storage.engine import server_lock
from drivecal.storage.engine.database import LASTING, PROMPT, Database

LONGEST_PAUSE = 10.0
GARBAGE = 20_000, 20, 20
"""Objects between two looks for garbage. A generation makes tens of thousands that live for a moment or to its end: with Python's own
thresholds the looks take an eighth of the dispatcher's time."""

T = TypeVar("T")
log = logging.getLogger(__name__)


def main() -> int:
    """Serves campaigns until SIGTERM or SIGINT."""
    if (descriptor := pulse.take_descriptor()) is not None:
        pulse.show(descriptor)
    memory.settle()
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    try:
        settings = load_settings()
        logs.configure("dispatcher", settings)
        serve(settings, stop, int(sys.argv[1]) if len(sys.argv) > 1 else None)
    except BackendLostError as error:
        log.error("%s; a new process replaces this one", error)  # noqa: TRY400  # the sentence says it all
        os._exit(1)  # Ray's own farewell, even that of the interpreter's end, would wait a minute for an answer
    except DrivecalError as error:
        log.error("%s", error)  # noqa: TRY400  # the sentence says it all; a traceback would bury it
        return 1
    return 0


def serve(settings: Settings, stop: threading.Event, server: int | None = None) -> None:
    """Runs as the database's dispatcher until `stop` is set; waits for the database and the workers. `server`: the supervisor's process.

    Raises DatabaseError if the database cannot be used, SupersededError if another dispatcher was elected, and BackendLostError if all
    workers are gone for good: a new process can recover.
    """
    database = Database.open(settings.database_url, LASTING)
    lock = _awaited("the database", lambda: _take_lock(database, settings, server), stop)
    if lock is None:
        return
    with lock:
        leadership = _awaited("the database", lambda: Leadership.begin(database), stop)
        if leadership is None:
            return
        log.info("elected for term %d", leadership.term)
        beating = Database.open(settings.database_url, PROMPT).fenced(leadership.fence)
        webhook = nullcontext() if settings.webhook is None else Webhook(beating, settings.webhook)
        with Heartbeat(beating, leadership, lock.renew) as heartbeat, webhook:
            _dispatch(settings, database.fenced(leadership.fence), leadership, heartbeat, stop)


def _dispatch(
    settings: Settings, database: Database, leadership: Leadership, heartbeat: Heartbeat, stop: threading.Event
) -> None:
    address = settings.ray_address
    heartbeat.report((), STARTING[1] if address is None else f"waiting for the Ray cluster at {address}")
    backend = _awaited("workers", lambda: _backend(settings, database), stop, lambda words: heartbeat.report((), words))
    if backend is None:
        return
    # the first campaign's start design needs it; while the workers start, a second of it costs nothing
    import_module("scipy.stats")
    gc.collect()
    gc.freeze()
    gc.set_threshold(*GARBAGE)
    free_at = time.monotonic() + leadership.free_in(backend.settle_seconds)
    resources = Resources(settings.resources, backend.settle_seconds, free_at)
    try:
        dispatcher = Dispatcher(
            database,
            WorkPool(backend, Leases(database), resources=resources),
            heartbeat.report,
            running_campaigns=settings.running_campaigns,
        )
        dispatcher.run(stop)
    except BackendLostError as error:
        heartbeat.report((), f"{error}; the workers are started or joined again")
        heartbeat.wait_until_stored()
        raise  # what is gone cannot be closed
    except BaseException:
        backend.close()
        raise
    backend.close()


def _backend(settings: Settings, database: Database) -> SupervisedBackend:
    """Starts the workers that the settings name: on Ray if it is installed, else as processes. Raises UnavailableError."""
    limits = WorkerLimits(workers=settings.workers, archive=partial(_archive, database))
    with_ray = find_spec("ray") is not None
    if settings.backend == "processes" or (settings.backend is None and not with_ray and settings.ray_address is None):
        from drivecal.execution.processes.backend import ProcessBackend

        return ProcessBackend(limits, trial())
    if not with_ray:
        raise UnavailableError("Ray is not installed; type pip install 'drivecal[cluster]', or serve with --backend processes")
    from drivecal.execution.ray.backend import RayBackend

    return RayBackend(limits, trial(), settings.ray_address)


def _archive(database: Database, digest: str) -> bytes:
    if (own := installed(digest)) is not None:
        return own.archive
    return database.query(bundles.archive, digest)


def _take_lock(database: Database, settings: Settings, server: int | None) -> server_lock.ServerLock:
    database.check()
    return server_lock.hold(settings.database_url, server=server)


def _awaited(what: str, make: Callable[[], T], stop: threading.Event, say: Callable[[str], None] = lambda _: None) -> T | None:
    """Returns what `make` returns as soon as it stops raising UnavailableError; None if the process must end first."""
    pause = 1.0
    while not stop.is_set():
        try:
            return make()
        except UnavailableError as error:
            log.warning("waiting for %s: %s", what, error)
            say(f"waiting for {what}: {error}")
            stop.wait(pause)
            pause = min(2 * pause, LONGEST_PAUSE)
    return None


if __name__ == "__main__":
    sys.exit(main())

"""Runs the dispatcher alone: `python -m drivecal.dispatch`, with the settings of `DRIVECAL_*`. `drivecal serve` starts it with the API."""

from __future__ import annotations

import logging
import signal
import sys
import threading

from drivecal.configuration.settings import load_settings
from drivecal.dispatch.dispatcher import Dispatcher
from drivecal.dispatch.trial import trial
from drivecal.domain.errors import DrivecalError, UnavailableError
from drivecal.execution.pool import WorkPool
from drivecal.execution.ray_backend import RayBackend, RayOptions
from drivecal.storage import locks
from drivecal.storage.database import Database

log = logging.getLogger(__name__)


def main() -> int:
    """Serves campaigns until SIGTERM or SIGINT."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s dispatcher: %(message)s")
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    try:
        settings = load_settings()
        database = Database.open(settings.database_url)
        database.check()
        with locks.hold(settings.database_url) as lock:
            backend = _backend(RayOptions(settings.ray_address, settings.workers), stop)
            if backend is None:
                return 0
            try:
                Dispatcher(database, WorkPool(backend), lock.renew).run(stop)
            finally:
                backend.close()
    except DrivecalError as error:
        log.error("%s", error)  # noqa: TRY400  # the sentence says it all; a traceback would bury it
        return 1
    return 0


def _backend(options: RayOptions, stop: threading.Event) -> RayBackend | None:
    """Ray, waited for; None where the process is to end first."""
    pause = 1.0
    while not stop.is_set():
        try:
            return RayBackend(options, trial())
        except UnavailableError as error:
            log.warning("waiting for Ray: %s", error)
            stop.wait(pause)
            pause = min(2 * pause, 10.0)
    return None


if __name__ == "__main__":
    sys.exit(main())

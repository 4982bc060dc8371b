"""Log of the reasons why a new API cannot use its database; `/readyz` reports the same."""

import logging
import threading
from collections.abc import Callable

from drivecal.domain.errors import DatabaseError
from drivecal.storage.engine.database import PROMPT, Database

LOOK_SECONDS = 2.0

log = logging.getLogger("drivecal.api")


def tell_of_database(url: str) -> None:
    """Checks the database at `url` in another thread until it can be used. The API answers meanwhile."""
    database = Database.open(url, PROMPT)

    def run() -> None:
        watch(database.check, threading.Event().wait)
        database.dispose()

    threading.Thread(target=run, name="await database", daemon=True).start()


def watch(check: Callable[[], None], pause: Callable[[float], object]) -> None:
    """Returns once `check` raises no DatabaseError any more. Logs each reason once, and the end of the trouble."""
    logged = None
    while True:
        try:
            check()
        except DatabaseError as error:
            if str(error) != logged:
                logged = str(error)
                log.error("campaigns wait: %s", logged)  # noqa: TRY400  # the sentence says it all; a traceback would bury it
            pause(LOOK_SECONDS)
        else:
            if logged is not None:
                log.info("the database can be used now")
            return

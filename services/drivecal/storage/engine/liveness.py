"""Connections to PostgreSQL that notice when the server does not answer any more, for requests with a waiting client.

A server that was stopped, or whose machine hangs, still accepts connections and never closes one; no timeout that it keeps itself ever
fires. So while a statement is silent, the server is asked for a new connection: one that is only busy gives it, and the statement may
go on; from one that does not, the connection is given up. After that, one caller a second tries again and all others are
told at once, so that requests do not pile up behind each other's waiting.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Generator
from typing import Any, TypeVar

import psycopg
from psycopg.conninfo import make_conninfo

SILENCE_SECONDS = 2.0
"""Silence of a statement before the server's liveness is checked."""
PROBE_SECONDS = 2
"""Longest time for a new connection."""
TRY_AGAIN_SECONDS = 1.0

Answer = TypeVar("Answer")
log = logging.getLogger(__name__)


def mind_absence(connection: psycopg.Connection[Any]) -> None:
    """Has the server end this session, with its locks, some 20 s after the client's machine is gone without a word; otherwise it would
    take hours."""
    for setting in ("tcp_keepalives_idle = 5", "tcp_keepalives_interval = 5", "tcp_keepalives_count = 3"):
        connection.execute(f"SET {setting}".encode())


class ServerLiveness:
    """State of one server: whether it answers, and if not, when the next caller may try. Threads share it."""

    def __init__(self, database: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._database = database
        self._clock = clock
        self._lock = threading.Lock()
        self._reason: str | None = None
        self._next_try = 0.0

    def connect(self, *arguments: Any, **options: Any) -> WatchedConnection:
        """A connection, as by `psycopg.connect`. Raises OperationalError, at once if the server was silent a moment ago."""
        with self._lock:
            if self._reason is not None:
                if self._clock() < self._next_try:
                    raise psycopg.OperationalError(self._reason)
                self._next_try = self._clock() + TRY_AGAIN_SECONDS + PROBE_SECONDS
        try:
            connection = WatchedConnection.connect(*arguments, **options)
        except psycopg.OperationalError as error:
            self.silent((str(error).splitlines() or ["no reason given"])[0])
            raise
        connection.watch = self
        self._answers()
        return connection

    def silent(self, reason: str) -> None:
        """Marks the server as not answering."""
        with self._lock:
            news, self._reason = self._reason is None, reason
            self._next_try = self._clock() + TRY_AGAIN_SECONDS
        if news:
            log.warning(
                "the database %s does not answer (%s): check that its server runs; drivecal continues by itself when it does",
                self._database,
                reason,
            )

    def _answers(self) -> None:
        with self._lock:
            news, self._reason = self._reason is not None, None
        if news:
            log.info("the database %s answers again", self._database)


class WatchedConnection(psycopg.Connection[Any]):
    """See the module; made by `Watch.connect`."""

    watch: ServerLiveness | None = None

    def wait(self, gen: Generator[Any, Any, Answer], *arguments: Any, **options: Any) -> Answer:
        """Carries a statement out, as psycopg does. Raises OperationalError, and closes the connection, if the server is silent."""
        return super().wait(self._watched(gen), *arguments, **options)

    def _watched(self, gen: Generator[Any, Any, Answer]) -> Generator[Any, Any, Answer]:
        """`gen`, which is resumed when the socket is ready, and several times a second with nothing while it is not."""
        patience_ends = time.monotonic() + SILENCE_SECONDS
        try:
            wanted = next(gen)
            while True:
                ready = yield wanted
                if not ready and time.monotonic() >= patience_ends:
                    self._probe()
                if ready or time.monotonic() >= patience_ends:
                    patience_ends = time.monotonic() + SILENCE_SECONDS
                wanted = gen.send(ready)
        except StopIteration as ended:
            answer: Answer = ended.value
            return answer

    def _probe(self) -> None:
        """Asks the server for another connection."""
        if self.watch is None:
            return
        place = {"host": self.info.host, "hostaddr": self.info.hostaddr or None, "port": self.info.port}
        same = make_conninfo(self.info.dsn, **place, password=self.info.password or None, connect_timeout=PROBE_SECONDS)
        try:
            psycopg.connect(same).close()
        except psycopg.OperationalError:
            reason = f"nothing came for {SILENCE_SECONDS + PROBE_SECONDS:.0f} s"
            self.watch.silent(reason)
            self.close()
            raise psycopg.OperationalError(reason) from None

"""Uvicorn's HTTP protocol with refusals as problem+json and a limit of connections, and its settings."""

import asyncio
import os
import socket
import sys
from http import HTTPStatus

import h11
import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.http.h11_impl import H11Protocol

from drivecal.api.http.problems import MEDIA_TYPE, problem_content
from drivecal.cluster.pulse import EVERY_SECONDS, sign

MOST_CONNECTIONS = 500
"""Largest number of open connections, idle ones included. Most systems allow a process 1,024 open files; the database takes at
least 40 of them."""
SECONDS_IDLE = 15
"""Seconds that a connection stays open for the next request."""
SECONDS_TO_STOP = 5
SECONDS_TO_READ = 2.0
"""Time for a refused client to read the refusal. A socket that is closed with unread bytes is reset, and the answer lost."""
MOST_IGNORED = 64 * 1_048_576
"""Bytes of a body that a client may still send after its answer, before its connection is closed."""


class Protocol(H11Protocol):
    """A connection of a client."""

    _is_refused = False
    _ignored = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn's own
        """Answers 503 if too many connections are open."""
        super().connection_made(transport)
        if len(self.connections) > MOST_CONNECTIONS:
            self._refuse(503, f"{MOST_CONNECTIONS:,} connections are open already; try again later", "Retry-After: 2\r\n")

    def data_received(self, data: bytes) -> None:
        """Receives data, except from a refused client, and ends a body that goes on after its answer."""
        if self._is_refused:
            return
        super().data_received(data)
        is_answered = self.cycle is not None and self.cycle.response_complete and self.conn.their_state is h11.SEND_BODY
        self._ignored = self._ignored + len(data) if is_answered else 0
        if self._ignored > MOST_IGNORED:
            self.transport.close()

    def send_400_response(self, msg: str) -> None:
        """Refuses invalid HTTP and large heads like every other bad request."""
        error = sys.exception()
        hint = error.error_status_hint if isinstance(error, h11.RemoteProtocolError) else 400
        detail = "the head of the request is too large" if hint == 431 else f"this is not an HTTP request: {error or msg}"
        if self.conn.our_state in {h11.IDLE, h11.SEND_RESPONSE}:
            self._refuse(hint, detail)
        else:
            self.transport.close()

    def _refuse(self, status: int, detail: str, headers: str = "") -> None:
        content = problem_content(status, detail)
        head = f"HTTP/1.1 {status} {HTTPStatus(status).phrase}\r\nContent-Type: {MEDIA_TYPE}\r\nContent-Length: {len(content)}\r\n{headers}"
        self.transport.write(head.encode() + b"Connection: close\r\n\r\n" + content)
        self.transport.write_eof()
        self._is_refused = True
        self.loop.call_later(SECONDS_TO_READ, self.transport.close)


class Server(uvicorn.Server):
    """Uvicorn's server, which ends event streams before it waits for running requests."""

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Ends all event streams and shuts down."""
        app = self.config.app
        if isinstance(app, FastAPI):
            app.state.event_hub.close()
        await super().shutdown(sockets)


def configuration(app: FastAPI, pulse: int | None = None) -> uvicorn.Config:
    """Returns uvicorn's configuration. `pulse`: the event loop writes signs of life to this descriptor."""

    async def show() -> None:
        if pulse is not None:
            sign(pulse)

    if pulse is not None:
        os.set_inheritable(pulse, False)
        os.set_blocking(pulse, False)
    return uvicorn.Config(
        app,
        http=Protocol,
        ws="none",
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_keep_alive=SECONDS_IDLE,
        timeout_graceful_shutdown=SECONDS_TO_STOP,
        callback_notify=show,
        timeout_notify=round(EVERY_SECONDS),
    )

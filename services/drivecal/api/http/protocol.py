"""Uvicorn's server and its settings, which limit connections and requests."""

import os
import socket

import h11
import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.http.h11_impl import H11Protocol

from drivecal.cluster.pulse import EVERY_SECONDS, sign

MOST_CONNECTIONS = 500
"""Connections, idle ones included, and requests beyond which uvicorn answers 503. Most systems allow a process 1,024 open files; the
database takes at least 40 of them."""
SECONDS_IDLE = 15
"""Seconds that a connection stays open for the next request."""
SECONDS_TO_STOP = 5
MOST_IGNORED = 64 * 1_048_576
"""Bytes of a body that a client may still send after its answer, before its connection is closed."""


class Protocol(H11Protocol):
    """A connection of a client, which ends if a body goes on after its answer: uvicorn would read it for ever."""

    _ignored = 0

    def data_received(self, data: bytes) -> None:
        """Receives data."""
        super().data_received(data)
        is_answered = self.cycle is not None and self.cycle.response_complete and self.conn.their_state is h11.SEND_BODY
        self._ignored = self._ignored + len(data) if is_answered else 0
        if self._ignored > MOST_IGNORED:
            self.transport.close()


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
        limit_concurrency=MOST_CONNECTIONS,
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

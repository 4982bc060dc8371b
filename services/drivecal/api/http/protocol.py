"""Uvicorn's HTTP protocol with a time limit for heads, a limit of connections, and refusals as problem+json."""

import asyncio
import socket
import sys
from http import HTTPStatus

import h11
import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.http.h11_impl import H11Protocol

from drivecal.api.http.closing import ClosingGently
from drivecal.api.http.problems import MEDIA_TYPE, problem_content

SECONDS_FOR_A_HEAD = 15.0
"""Limit from the connection, or from the first byte after an answer, to the end of the headers."""
MOST_CONNECTIONS = 500
"""Largest number of open connections, idle ones included. Most systems allow a process 1,024 open files; the database takes at
least 40 of them."""
SECONDS_IDLE = 15
"""Seconds that a connection stays open for the next request."""
SECONDS_TO_STOP = 5
LARGEST_LIVE_MESSAGE = 4_096
"""Bytes that a page may send at once over a WebSocket."""


class Protocol(H11Protocol):
    """A connection of a client."""

    _impatience: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn's own
        """Answers 503 if too many connections are open."""
        connection = transport.get_extra_info("socket")
        if connection is not None and connection.family != socket.AF_UNIX:
            # asyncio does this for listeners that name their protocol, which those of `socket.create_server` do not; without it every
            # answer on a kept connection waits 40 ms for the client's acknowledgement.
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._gently = ClosingGently(transport, self._expects_more)
        super().connection_made(self._gently)
        if len(self.connections) > MOST_CONNECTIONS:
            self._refuse(503, f"{MOST_CONNECTIONS:,} connections are open already; try again later", "Retry-After: 2\r\n")
        self._expect_a_head()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Hands the connection on to its new protocol."""
        self._stop_waiting()
        self._gently.hand_on()
        super().handle_websocket_upgrade(event)

    def data_received(self, data: bytes) -> None:
        """Receives data and limits the time for a head."""
        if self._gently.lingers:
            self._gently.throw_away(data)
            return
        super().data_received(data)
        if not self._gently.gone:
            self._expect_a_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stops all timers."""
        self._gently.stop()
        super().connection_lost(exc)
        self._stop_waiting()

    def send_400_response(self, msg: str) -> None:
        """Refuses invalid HTTP and large heads like every other bad request."""
        error = sys.exception()
        hint = error.error_status_hint if isinstance(error, h11.RemoteProtocolError) else 400
        detail = "the head of the request is too large" if hint == 431 else f"this is not an HTTP request: {error or msg}"
        if self.conn.our_state in {h11.IDLE, h11.SEND_RESPONSE}:
            self._refuse(hint, detail)
        else:
            self.transport.close()

    def _expects_more(self) -> bool:
        """Returns whether the client may still be sending."""
        done = {h11.DONE, h11.MUST_CLOSE, h11.CLOSED}
        return not (self.conn.their_state in done or (self.cycle is not None and self.conn.their_state is h11.IDLE))

    def _expect_a_head(self) -> None:
        if self.conn.their_state is not h11.IDLE or self.transport.is_closing():
            self._stop_waiting()
        elif self._impatience is None and (self.cycle is None or self.conn.trailing_data[0]):
            self._impatience = self.loop.call_later(SECONDS_FOR_A_HEAD, self._give_up)

    def _stop_waiting(self) -> None:
        if self._impatience is not None:
            self._impatience.cancel()
            self._impatience = None

    def _give_up(self) -> None:
        self._impatience = None
        if not self.transport.is_closing():
            self._refuse(408, f"the head of the request was not complete after {SECONDS_FOR_A_HEAD:g} seconds")

    def _refuse(self, status: int, detail: str, headers: str = "") -> None:
        content = problem_content(status, detail)
        head = f"HTTP/1.1 {status} {HTTPStatus(status).phrase}\r\nContent-Type: {MEDIA_TYPE}\r\nContent-Length: {len(content)}\r\n{headers}"
        self.transport.write(head.encode() + b"Connection: close\r\n\r\n" + content)
        self.transport.close()


class Server(uvicorn.Server):
    """Uvicorn's server, which ends event streams before it waits for running requests."""

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Ends all event streams and shuts down."""
        app = self.config.app
        if isinstance(app, FastAPI):
            app.state.event_hub.close()
        await super().shutdown(sockets)


def configuration(app: FastAPI) -> uvicorn.Config:
    """Returns uvicorn's configuration."""
    return uvicorn.Config(
        app,
        http=Protocol,
        ws="websockets-sansio",
        ws_max_size=LARGEST_LIVE_MESSAGE,
        ws_per_message_deflate=False,
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_keep_alive=SECONDS_IDLE,
        timeout_graceful_shutdown=SECONDS_TO_STOP,
    )

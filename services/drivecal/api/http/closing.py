"""Closing of connections so that the last answer arrives, and without a client that reads none.

A socket that is closed with unread bytes is reset, and with the reset the answer is lost: a client that should see a 413 would see a broken
connection. So the answer and its end are sent first, and further data are ignored for a moment.

A client that does not read keeps its answer in memory, its place and its connection, even after `close`, which waits for the rest to be
sent. So a connection is aborted if its client takes nothing of an answer for `STALLED_SECONDS`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

LINGER_SECONDS = 2.0
LINGER_BYTES = 64 * 1_048_576
STALLED_SECONDS = 300.0
"""Time without any progress of an answer after which its connection is aborted."""


class ClosingGently(asyncio.Transport):
    """A transport whose `close` lingers if `expects_more` returns that the client is still sending. It gives up on clients that do not
    read."""

    def __init__(self, transport: asyncio.Transport, expects_more: Callable[[], bool]) -> None:
        super().__init__()
        self._transport = transport
        self._expects_more = expects_more
        self._thrown_away = 0
        self._end: asyncio.TimerHandle | None = None
        self._written = 0
        self._watched = False
        self.gone = False
        """True once another protocol has it."""

    def hand_on(self) -> None:
        """Lets another protocol take the connection over, whose `close` does not linger."""
        self.gone = True

    def set_protocol(self, protocol: asyncio.BaseProtocol) -> None:
        """Sets the protocol that receives the client's data."""
        self._transport.set_protocol(protocol)

    @property
    def lingers(self) -> bool:
        """True after the last answer, while further data are ignored."""
        return self._end is not None

    def close(self) -> None:
        """Ends the connection once everything was sent; called again, at once."""
        if (
            self.gone
            or self.lingers
            or self._transport.is_closing()
            or not self._expects_more()
            or not self._transport.can_write_eof()
        ):
            self.stop()
            return
        self._end = asyncio.get_running_loop().call_later(LINGER_SECONDS, self.stop)
        self._transport.write_eof()
        self._transport.resume_reading()

    def throw_away(self, data: bytes) -> None:
        """Ignores data after the last answer."""
        self._thrown_away += len(data)
        if self._thrown_away > LINGER_BYTES:
            self.stop()

    def stop(self) -> None:
        """Ends the connection at once."""
        if self._end is not None:
            self._end.cancel()
        self._transport.close()

    def is_closing(self) -> bool:
        """Returns True if nothing more can be written."""
        return self.lingers or self._transport.is_closing()

    def write(self, data: bytes | bytearray | memoryview[Any]) -> None:
        """Sends data, unless the last answer was sent already."""
        if self.lingers:
            return
        self._transport.write(data)
        self._written += len(data)
        if not self._watched and self._transport.get_write_buffer_size():
            self._watch()

    def _watch(self) -> None:
        self._watched = True
        taken = self._written - self._transport.get_write_buffer_size()
        asyncio.get_running_loop().call_later(STALLED_SECONDS, self._look, taken)

    def _look(self, taken_before: int) -> None:
        """Aborts the connection if the client has taken no byte since; a closed one holds none."""
        self._watched = False
        waiting = self._transport.get_write_buffer_size()
        if waiting and self._written - waiting == taken_before:
            self._transport.abort()
        elif waiting:
            self._watch()

    def pause_reading(self) -> None:
        if not self.lingers:
            self._transport.pause_reading()

    def resume_reading(self) -> None:
        self._transport.resume_reading()

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        """Returns information about the socket."""
        return self._transport.get_extra_info(name, default)

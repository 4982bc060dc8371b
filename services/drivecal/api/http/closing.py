"""Closing of connections so that the last answer arrives.

A socket that is closed with unread bytes is reset, and with the reset the answer is lost: a client that should see a 413 would see a broken
connection. So the answer and its end are sent first, and further data are ignored for a moment.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

LINGER_SECONDS = 2.0
LINGER_BYTES = 64 * 1_048_576


class ClosingGently(asyncio.Transport):
    """A transport whose `close` lingers if `expects_more` returns that the client is still sending."""

    def __init__(self, transport: asyncio.Transport, expects_more: Callable[[], bool]) -> None:
        super().__init__()
        self._transport = transport
        self._expects_more = expects_more
        self._thrown_away = 0
        self._end: asyncio.TimerHandle | None = None
        self.gone = False
        """True once another protocol has it."""

    def handed_on(self) -> asyncio.Transport:
        """Returns the connection itself, for a protocol that takes it over."""
        self.gone = True
        return self._transport

    @property
    def lingers(self) -> bool:
        """True after the last answer, while further data are ignored."""
        return self._end is not None

    def close(self) -> None:
        """Ends the connection once everything was sent; called again, at once."""
        if self.lingers or self._transport.is_closing() or not self._expects_more() or not self._transport.can_write_eof():
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
        if not self.lingers:
            self._transport.write(data)

    def pause_reading(self) -> None:
        if not self.lingers:
            self._transport.pause_reading()

    def resume_reading(self) -> None:
        self._transport.resume_reading()

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        """Returns information about the socket."""
        return self._transport.get_extra_info(name, default)

"""Reads `text/event-stream` as the HTML standard has it (9.2.6): https://html.spec.whatwg.org/multipage/server-sent-events.html"""

from __future__ import annotations

import re
from dataclasses import dataclass

_LINE = re.compile(rb"([^\r\n]*)(\r\n|\n|\r(?!\n))")


@dataclass(frozen=True, slots=True)
class ServerSentEvent:
    """One event. `id` is None where the stream gave this very event none."""

    event: str
    data: str
    id: str | None


class EventParser:
    """Takes a stream as it comes in, cut anywhere. An event that is not complete when the stream ends never was one; when to come back,
    who reads knows better than the server."""

    def __init__(self) -> None:
        self._rest = b""
        self._begun = False
        self._event = ""
        self._data: list[str] = []
        self._id: str | None = None

    def feed(self, chunk: bytes) -> list[ServerSentEvent]:
        """The events that are complete with this chunk."""
        self._rest += chunk
        if not self._begun and len(self._rest) >= 3:
            self._rest, self._begun = self._rest.removeprefix(b"\xef\xbb\xbf"), True
        found: list[ServerSentEvent] = []
        end = 0
        for match in _LINE.finditer(self._rest):
            if match.group(2) == b"\r" and match.end() == len(self._rest):
                break  # perhaps the first half of \r\n
            end = match.end()
            event = self._take(match.group(1).decode("utf-8", errors="replace"))
            if event is not None:
                found.append(event)
        self._rest = self._rest[end:]
        return found

    def _take(self, line: str) -> ServerSentEvent | None:
        if not line:
            return self._dispatch()
        name, _, value = line.partition(":")
        value = value.removeprefix(" ")
        match name:
            case "event":
                self._event = value
            case "data":
                self._data.append(value)
            case "id" if "\0" not in value:
                self._id = value
        return None

    def _dispatch(self) -> ServerSentEvent | None:
        event, data, number = self._event, self._data, self._id
        self._event, self._data, self._id = "", [], None
        return ServerSentEvent(event or "message", "\n".join(data), number) if data else None

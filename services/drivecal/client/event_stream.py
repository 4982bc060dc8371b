"""Reads `text/event-stream` as the HTML standard has it (9.2.6): https://html.spec.whatwg.org/multipage/server-sent-events.html"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ServerSentEvent:
    """An event. `id` is None if this event has none in the stream."""

    event: str
    data: str
    id: str | None


class EventParser:
    """A parser of a stream that arrives in arbitrary pieces. It drops an event that is incomplete at the end, and ignores `retry`."""

    def __init__(self) -> None:
        self._rest = b""
        self._begun = False
        self._event = ""
        self._data: list[str] = []
        self._id: str | None = None

    def feed(self, chunk: bytes) -> list[ServerSentEvent]:
        """Returns the events that this chunk completes."""
        self._rest += chunk
        if not self._begun and len(self._rest) >= 3:
            self._rest, self._begun = self._rest.removeprefix(b"\xef\xbb\xbf"), True
        lines = self._rest.splitlines(keepends=True)  # of bytes: at \n, \r and \r\n, as the standard says
        # What has no end yet waits for the rest, and so does a \r that may be the first half of a \r\n.
        self._rest = lines.pop() if lines and not lines[-1].endswith(b"\n") else b""
        taken = (self._take(line.rstrip(b"\r\n").decode("utf-8", errors="replace")) for line in lines)
        return [field for field in taken if field is not None]

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

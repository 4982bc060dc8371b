"""Limits of requests: their size, the time to arrive, and the number answered at once."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Mapping
from contextlib import ExitStack

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from drivecal.api.http.authorisation import is_of_the_page
from drivecal.api.http.problems import problem_response
from drivecal.domain.errors import OverloadError

LARGEST_BODY = 1_048_576
"""Bytes. The largest campaign that the contracts allow takes a fraction of it."""
SECONDS_FOR_A_BODY = 30.0
"""Limit from the head of a request to the end of its body."""
SECONDS_FOR_A_PROBLEM = 300.0
"""The same for a pushed problem, which may be larger."""
LONGEST_PATH = 8_192
LONGEST_QUERY = 32_768
LARGEST_HEAD = 65_536
"""Bytes of all headers together. The parser refuses most that is larger than 16 kB, but not what arrives in one piece."""
MOST_REQUESTS = 200
"""Requests being answered or waiting for one of the 40 threads. Without a bound, abandoned requests would be answered first."""
MOST_REQUESTS_OF_STRANGERS = 8
"""Requests without a token at a server with tokens, such as probes of /readyz."""
MOST_FILES_OF_STRANGERS = 64
"""Files of the page at a time without a token: a few browsers that open it together."""
CLOSE = {"Connection": "close"}


class Requests:
    """ASGI middleware that bounds a request's head, and its body's size and time.

    It also ends connections with unread bodies, which would otherwise be read to their ends.
    """

    def __init__(
        self,
        app: ASGIApp,
        largest: int = LARGEST_BODY,
        seconds: float = SECONDS_FOR_A_BODY,
        *,
        others: Mapping[str, tuple[int, float]] | None = None,
    ) -> None:
        """Limits the bytes and the seconds of bodies. `others`: these limits by path, for paths that have their own."""
        self.app = app
        self.usual = largest, seconds
        self.others = others or {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes the request on, counting."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        request = Request(scope)
        largest, seconds = self.others.get(scope["path"], self.usual)
        too_much = self._too_much(request, largest)
        if too_much is not None:
            await problem_response(request, *too_much, headers=CLOSE)(scope, receive, send)
            return
        body = _Body(receive, largest, seconds, unread=_has_body(request))

        async def closing(message: Message) -> None:
            if message["type"] == "http.response.start":
                body.answered = True
                if body.unread:
                    kept = [pair for pair in message.get("headers", []) if pair[0].lower() != b"connection"]
                    message = {**message, "headers": [*kept, (b"connection", b"close")]}
            await send(message)

        await self.app(scope, body.receive, closing)

    def _too_much(self, request: Request, largest: int) -> tuple[int, str] | None:
        """Returns status and sentence of a refusal because of the head of a request, else None."""
        path, query = request.scope.get("raw_path") or b"", request.scope["query_string"]
        if len(path) > LONGEST_PATH or len(query) > LONGEST_QUERY:
            read = f"at most {LONGEST_PATH:,} and {LONGEST_QUERY:,} are read"
            return 414, f"the path has {len(path):,} bytes and the query {len(query):,}; {read}"
        head = sum(len(name) + len(value) for name, value in request.scope["headers"])
        if head > LARGEST_HEAD:
            return 431, f"the headers have {head:,} bytes; at most {LARGEST_HEAD:,} are read"
        declared = request.headers.get("content-length", "0")
        if not declared.isdecimal() or len(declared) > 20 or int(declared) > largest:
            return 413, _too_large(largest)
        return None


class _Body:
    """The body of one request as it comes in."""

    def __init__(self, receive: Receive, largest: int, seconds: float, *, unread: bool) -> None:
        self._receive = receive
        self._largest = largest
        self._seconds = seconds
        self._until = time.monotonic() + seconds
        self._received = 0
        self.unread = unread
        """True while a part of it may still come."""
        self.answered = False
        """True once the status has been sent: then nothing can be refused any more, only ended."""

    async def receive(self) -> Message:
        """Returns the next part. Raises HTTPException 413 or 408."""
        if not self.unread:
            return await self._receive()
        try:
            async with asyncio.timeout(self._until - time.monotonic()):
                message = await self._receive()
        except TimeoutError:
            return self._refuse(408, f"the body was not complete after {self._seconds:g} seconds")
        self._received += len(message.get("body", b""))
        if self._received > self._largest:
            return self._refuse(413, _too_large(self._largest))
        self.unread = message["type"] == "http.request" and message.get("more_body", False)
        return message

    def _refuse(self, status: int, detail: str) -> Message:
        if self.answered:
            return {"type": "http.disconnect"}
        raise HTTPException(status, detail, headers=CLOSE)


def _has_body(request: Request) -> bool:
    return "transfer-encoding" in request.headers or request.headers.get("content-length", "0").strip("0") != ""


def _too_large(largest: int) -> str:
    return f"the body is larger than {largest:,} bytes; send a smaller one"


class Places:
    """A limited number of places. Any thread may take a place and give it back."""

    def __init__(self, most: int, what: str, retry_seconds: int) -> None:
        self._most = most
        self._what = what
        self._retry_seconds = retry_seconds
        self._lock = threading.Lock()
        self.taken = 0

    def take(self) -> Place:
        """Takes a place; the caller returns it. Raises OverloadError if all are taken."""
        with self._lock:
            if self.taken >= self._most:
                raise OverloadError(f"{self._most:,} {self._what} already; try again later", self._retry_seconds)
            self.taken += 1
        place = Place()
        place.callback(self._give_back)
        return place

    def _give_back(self) -> None:
        with self._lock:
            self.taken -= 1


class Place(ExitStack):
    """A place in `Places`; giving it back twice changes nothing."""

    def give_back(self) -> None:
        """Frees the place for another request."""
        self.close()


class Concurrency:
    """ASGI middleware that answers 503 if too many requests are being answered.

    `request.state.place` is the request's place, which an event stream gives back because it only waits. Requests that lack a token have
    their own places, and more of them for files of the page and the documentation, of which a browser asks for a dozen at once.
    """

    def __init__(self, app: ASGIApp, most: int = MOST_REQUESTS, strangers: int = MOST_REQUESTS_OF_STRANGERS) -> None:
        self.app = app
        self.places = Places(most, "requests are being answered", retry_seconds=2)
        self.places_of_strangers = Places(strangers, "requests without a token are being answered", retry_seconds=2)
        self.places_of_files = Places(MOST_FILES_OF_STRANGERS, "files of the page are being answered", retry_seconds=2)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes the request on if there is a place for it."""
        if scope["type"] != "http" or scope["path"] == "/healthz":  # a server that has much to do lives
            await self.app(scope, receive, send)
            return
        stranger = scope.setdefault("state", {}).get("token") is None
        places = self.places
        if stranger:
            places = self.places_of_files if is_of_the_page(scope) else self.places_of_strangers
        try:
            place = places.take()
        except OverloadError as error:
            headers = {"Retry-After": str(error.retry_seconds)}
            await problem_response(Request(scope), 503, str(error), headers=headers)(scope, receive, send)
            return
        with place:
            scope["state"]["place"] = place
            await self.app(scope, receive, send)

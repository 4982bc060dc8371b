"""Limits of requests: the size of their bodies, and places for costly ones.

A proxy in front of the server limits clients that are slow; uvicorn closes idle connections, refuses large heads and limits the number of
requests.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from drivecal.api.http.problems import problem_response
from drivecal.domain.errors import OverloadError

LARGEST_BODY = 1_048_576
"""Bytes. The largest campaign that the contracts allow takes a fraction of it."""
CLOSE = {"Connection": "close"}


class BodyLimit:
    """ASGI middleware that refuses bodies that are too large (413), by their declaration or when they turn out to be, or that declare their
    length twice (400)."""

    def __init__(self, app: ASGIApp, others: Mapping[str, int]) -> None:
        """Limits the bytes of bodies to LARGEST_BODY, or to the number in `others` for a path that is there."""
        self.app = app
        self.others = others

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes the request on, counting."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        request = Request(scope)
        largest, received = self.others.get(scope["path"], LARGEST_BODY), 0
        detail = f"the body is larger than {largest:,} bytes; send a smaller one"
        if "content-length" in request.headers and "transfer-encoding" in request.headers:
            both = "the body has both Content-Length and Transfer-Encoding; send one of them"  # a proxy may believe the other
            await problem_response(request, 400, both, headers=CLOSE)(scope, receive, send)
            return
        declared = request.headers.get("content-length", "0")
        if not declared.isdecimal() or len(declared) > 20 or int(declared) > largest:
            await problem_response(request, 413, detail)(scope, receive, send)  # uvicorn throws the body away as it comes
            return

        async def counting() -> Message:
            nonlocal received
            message = await receive()
            received += len(message.get("body", b""))
            if received > largest:
                raise HTTPException(413, detail, headers=CLOSE)
            return message

        await self.app(scope, counting, send)


@dataclass(slots=True)
class Places:
    """A limited number of places, which the event loop takes and gives back."""

    most: int
    noun: str
    """Use of a place, e.g. `event streams are open`."""
    retry_seconds: int
    """Time after which a refused client should try again."""
    taken: int = 0

    @contextmanager
    def take(self) -> Iterator[None]:
        """Takes a place for a block. Raises OverloadError if all are taken."""
        if self.taken >= self.most:
            raise OverloadError(f"{self.most:,} {self.noun} already; try again later", self.retry_seconds)
        self.taken += 1
        try:
            yield
        finally:
            self.taken -= 1

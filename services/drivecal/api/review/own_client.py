"""A client of this very server, for answers that need many others."""

from collections.abc import AsyncIterable
from contextlib import aclosing
from typing import cast

import httpx
from anyio import from_thread
from fastapi import Request

from drivecal.client.client import Client

RIGHTS = ("authorization", "cookie", "host")
"""Headers that decide what a request may read."""


def own_client(request: Request) -> Client:
    """Returns a client that reads what `request` may read, without a connection. Use it in a worker thread of the server's event loop."""
    return Client(str(request.base_url), token="", transport=_Own(request))


class _Own(httpx.BaseTransport):
    """Passes requests to the application of another request, with that one's rights."""

    def __init__(self, request: Request) -> None:
        self._application = httpx.ASGITransport(request.app)
        self._rights = {name: request.headers[name] for name in RIGHTS if name in request.headers}

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        request.headers.update(self._rights)
        return from_thread.run(self._answered, request)

    async def _answered(self, request: httpx.Request) -> httpx.Response:
        response = await self._application.handle_async_request(request)
        async with aclosing(response):
            pieces = cast("AsyncIterable[bytes]", response.stream)
            content = b"".join([piece async for piece in pieces])
        return httpx.Response(response.status_code, headers=response.headers, stream=httpx.ByteStream(content))

"""Reads request bodies strictly before FastAPI validates them, so that nothing odd ever reaches a handler or an error message."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from email.message import Message
from typing import Any

from fastapi import Request, Response
from fastapi.routing import APIRoute
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from drivecal.contracts import strict_json


class StrictRoute(APIRoute):
    """A route whose JSON body is read by `drivecal.contracts.strict_json`."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """FastAPI's handler behind the strict reader."""
        handle = super().get_route_handler()
        if self.body_field is None:
            return handle

        async def strictly(request: Request) -> Response:
            content = await _content(request)
            if not _is_json(request.headers.get("content-type", "")):
                raise HTTPException(415, "the body is not declared as JSON; send Content-Type: application/json")
            return await handle(_Parsed(request, content, strict_json.loads(content)))

        return strictly


class _Parsed(Request):
    """A request whose body has been read and parsed already."""

    def __init__(self, request: Request, content: bytes, document: object) -> None:
        super().__init__(request.scope, request.receive)
        self._content = content
        self._document = document

    async def body(self) -> bytes:
        return self._content

    async def json(self) -> Any:
        return self._document


async def _content(request: Request) -> bytes:
    try:
        return await request.body()
    except ClientDisconnect as error:
        raise HTTPException(400, "the client went away before its body was complete") from error


def _is_json(content_type: str) -> bool:
    message = Message()
    message["content-type"] = content_type
    main, _, sub = message.get_content_type().partition("/")
    return main == "application" and (sub == "json" or sub.endswith("+json"))

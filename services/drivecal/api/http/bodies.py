"""Strict reading of request bodies before FastAPI sees them, so that nothing odd reaches a handler or an error message."""

from collections.abc import Callable, Coroutine
from email.message import Message
from typing import Any

from anyio import to_thread
from fastapi import Request, Response
from fastapi.routing import APIRoute
from pydantic import BaseModel
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from drivecal.api.dependencies import Limits
from drivecal.configuration.memory import give_back
from drivecal.contracts import strict_json
from drivecal.contracts.input_errors import validated
from drivecal.domain.errors import DrivecalError

LARGE = 16_384
"""Size in bytes from which bodies are read in turn: a hostile megabyte takes up to a second."""


class StrictRoute(APIRoute):
    """A route whose JSON body is read and checked outside the event loop."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Returns FastAPI's handler behind the strict reader."""
        handle = super().get_route_handler()
        if self.body_field is None:
            return handle
        model = self.body_field.field_info.annotation
        if not (isinstance(model, type) and issubclass(model, BaseModel)):
            raise TypeError(f"{self.path} takes a body that is not a model")

        def read(request: Request, content: bytes) -> _Read:
            return _Read(request, validated(model, strict_json.loads(content)))

        async def strictly(request: Request) -> Response:
            _check_declaration(request)
            content = await body_of(request)
            if len(content) < LARGE:
                return await handle(await to_thread.run_sync(read, request, content))
            limits: Limits = request.app.state.limits
            with limits.waiting_bodies.take():
                async with limits.large_bodies:
                    try:
                        return await handle(await to_thread.run_sync(read, request, content))
                    except DrivecalError as error:
                        # Its sentences are all that is needed; the frames and errors behind it hold on to the document.
                        error.__cause__ = error.__context__ = None
                        raise error.with_traceback(None) from None
                    finally:
                        await to_thread.run_sync(give_back)

        return strictly


class _Read(Request):
    """A request whose body has been read and checked already. FastAPI takes the model as it is."""

    def __init__(self, request: Request, document: BaseModel) -> None:
        super().__init__(request.scope, request.receive)
        self._document = document

    async def body(self) -> bytes:
        return b"{}"  # there is one; what is in it, `json` gives

    async def json(self) -> Any:
        return self._document


def check_encoding(request: Request) -> None:
    """Raises HTTPException 415 for a compressed body."""
    encoding = request.headers.get("content-encoding", "identity").strip().lower()
    if encoding not in {"", "identity"}:
        detail = "compressed bodies are not read; send it as it is, without Content-Encoding"
        raise HTTPException(415, detail, headers={"Accept-Encoding": "identity"})


def _check_declaration(request: Request) -> None:
    """Raises HTTPException 415 for a body that is not declared as plain JSON."""
    check_encoding(request)
    message = Message()
    message["content-type"] = request.headers.get("content-type", "")
    main, _, sub = message.get_content_type().partition("/")
    if main != "application" or not (sub == "json" or sub.endswith("+json")):
        raise HTTPException(415, "the body is not declared as JSON; send Content-Type: application/json")


async def body_of(request: Request) -> bytes:
    """Returns the whole body. Raises HTTPException 400 if the client goes away."""
    try:
        return await request.body()
    except ClientDisconnect as error:
        raise HTTPException(400, "the client went away before its body was complete") from error

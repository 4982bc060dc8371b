"""Errors as problem+json (RFC 9457): one document shape, with each faulty field and its remedy."""

import json
import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException

from drivecal.contracts import input_errors
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import (
    ConflictError,
    DatabaseError,
    DrivecalError,
    InvalidInputError,
    NotFoundError,
    OverloadError,
    Problem,
    TooLargeError,
    UnavailableError,
)

MEDIA_TYPE = "application/problem+json"
RETRY_SECONDS = 5
"""`Retry-After` while a part of the service does not answer."""
REQUEST_ID = "X-Request-ID"
"""The header with the id under which the log speaks of a request."""
MOST_PROBLEMS = 100
"""Largest number of problems in an answer."""

log = logging.getLogger("drivecal.api")


class FieldProblem(BaseModel):
    """A problem; `field` is a dotted path, empty for the whole request."""

    field: str
    message: str
    remedy: str


class ProblemDocument(BaseModel):
    """RFC 9457, with `errors` as an extension."""

    type: str
    title: str
    status: int
    detail: str
    instance: str
    errors: list[FieldProblem]


RESPONSES: dict[int | str, dict[str, Any]] = {
    status: {"model": ProblemDocument, "description": description, "content": {MEDIA_TYPE: {}}}
    for status, description in {
        400: "The request is not complete",
        401: "A token is missing or unknown",
        403: "The token may only read or not push, a signature is missing, or a web page of another origin asks",
        404: "There is no such thing",
        405: "The method is not possible here",
        409: "The request contradicts the state or an earlier request",
        413: "The body, or the campaign that it describes, is too large, or there are too many influence maps or problems",
        415: "The body is not declared as JSON (of a problem: application/zip), or is compressed",
        421: "A server without tokens does not answer to this Host",
        422: "Fields do not fit; `errors` names each",
        429: "The queue is full, or too many event streams or archives of problems are open",
        503: "The database does not answer",
    }.items()
}


def problem_response(
    request: Request, status: int, detail: str, errors: Sequence[Problem] = (), headers: Mapping[str, str] | None = None
) -> Response:
    """Returns the answer for an error."""
    if len(errors) > MOST_PROBLEMS:
        errors = [
            *errors[:MOST_PROBLEMS],
            Problem("", f"{len(errors) - MOST_PROBLEMS:,} more are not listed", "mend these first"),
        ]
        detail = "\n".join(map(str, errors))
    title, instance = HTTPStatus(status).phrase, request.url.path
    document = {"type": "about:blank", "title": title, "status": status, "detail": detail or title, "instance": instance}
    content = json.dumps(document | {"errors": [asdict(error) for error in errors]}, ensure_ascii=True)
    return Response(content.encode(), status, headers=dict(headers or {}), media_type=MEDIA_TYPE)


def install(app: FastAPI) -> None:
    """Registers the handlers, so that every error of the service has this shape."""
    app.exception_handlers |= {
        DrivecalError: _drivecal_error,
        RequestValidationError: _validation_error,
        HTTPException: _http_error,
        SQLAlchemyError: _database_error,
        Exception: _unexpected,
    }


async def _drivecal_error(request: Request, error: Exception) -> Response:
    if isinstance(error, InvalidInputError):
        status = 413 if isinstance(error, TooLargeError) else 422
        return problem_response(request, status, str(error), error.problems)
    if isinstance(error, OverloadError):
        return problem_response(request, 429, str(error), headers={"Retry-After": str(error.retry_seconds)})
    if isinstance(error, NotFoundError):
        return problem_response(request, 404, str(error))
    if isinstance(error, ConflictError):
        return problem_response(request, 409, str(error))
    if isinstance(error, (UnavailableError, DatabaseError)):
        return problem_response(request, 503, str(error), headers={"Retry-After": str(RETRY_SECONDS)})
    return await _unexpected(request, error)


async def _validation_error(request: Request, error: RequestValidationError) -> Response:
    """Answers FastAPI's own errors of query, path and header parameters; `drivecal.api.http.bodies` reads bodies."""
    problems = [
        input_errors.problem(".".join(shown(part) for part in detail["loc"][1:]), detail)
        for detail in error.errors()[: MOST_PROBLEMS + 1]
    ]
    return problem_response(request, 422, "\n".join(map(str, problems)), problems)


async def _database_error(request: Request, error: Exception) -> Response:
    """Answers unnamed database errors, such as a lost table. A later attempt may succeed."""
    log.error("%s %s: the database fails", request.method, request.url.path, exc_info=error)
    detail = "the database does not do what drivecal asks of it; the server's log says more"
    return problem_response(request, 503, detail, headers={"Retry-After": str(RETRY_SECONDS)})


async def _http_error(request: Request, error: HTTPException) -> Response:
    detail = str(error.detail)
    if error.status_code == HTTPStatus.NOT_FOUND and detail == HTTPStatus.NOT_FOUND.phrase:
        detail = f"there is nothing at {shown(request.url.path)}; see /docs for what there is"
    headers = error.headers
    if error.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
        headers = {"Allow": ", ".join(_methods(request)) or "GET"}
        detail = f"{shown(request.method)} is not possible here; {headers['Allow']} is"
    return problem_response(request, error.status_code, detail, headers=headers)


def _methods(request: Request) -> list[str]:
    """Returns the methods of all routes that match a request's path."""
    allowed: set[str] = set()
    for template, methods in request.app.openapi()["paths"].items():
        pattern = "".join("[^/]+" if part.startswith("{") else re.escape(part) for part in re.split(r"(\{\w+\})", template))
        if re.fullmatch(pattern, request.scope["path"], re.DOTALL):
            allowed |= {method.upper() for method in methods}
    return sorted(allowed)


async def _unexpected(request: Request, error: Exception) -> Response:
    log.error("%s %s failed", request.method, request.url.path, exc_info=error)
    request_id = getattr(request.state, "request_id", "")
    detail = f"drivecal made a mistake; the server's log says more about request {request_id}"
    return problem_response(request, 500, detail, headers={REQUEST_ID: request_id})

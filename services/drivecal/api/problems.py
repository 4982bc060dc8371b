"""Every error as problem+json (RFC 9457): one document shape, with each field that is wrong and what would be right."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel
from starlette.exceptions import HTTPException

from drivecal.contracts import validation
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import (
    ConflictError,
    DatabaseError,
    DrivecalError,
    InvalidInputError,
    NotFoundError,
    Problem,
    UnavailableError,
)

MEDIA_TYPE = "application/problem+json"
RETRY_SECONDS = 5
"""What a client is told to wait when something the service depends on does not answer."""

log = logging.getLogger("drivecal.api")


class FieldProblem(BaseModel):
    """One thing that is wrong: `field` is a dotted path, empty where it is about the request as a whole."""

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
        404: "There is no such thing",
        409: "The request contradicts the state or an earlier request",
        413: "The body is too large",
        415: "The body is not declared as JSON",
        422: "Fields do not fit; `errors` names each",
        503: "The database or the dispatcher does not answer",
    }.items()
}


def problem_response(
    request: Request, status: int, detail: str, errors: Sequence[Problem] = (), headers: Mapping[str, str] | None = None
) -> Response:
    """The answer for something that went wrong."""
    title = HTTPStatus(status).phrase
    document = {
        "type": "about:blank",
        "title": title,
        "status": status,
        "detail": detail or title,
        "instance": request.url.path,
        "errors": [{"field": one.field, "message": one.message, "remedy": one.remedy} for one in errors],
    }
    content = json.dumps(document, ensure_ascii=True).encode()
    return Response(content, status, headers=dict(headers or {}), media_type=MEDIA_TYPE)


def install(app: FastAPI) -> None:
    """Registers the handlers, so that every error of the service has this one shape."""
    app.add_exception_handler(DrivecalError, _drivecal_error)
    app.add_exception_handler(RequestValidationError, _validation_error)
    app.add_exception_handler(HTTPException, _http_error)
    app.add_exception_handler(Exception, _unexpected)


async def _drivecal_error(request: Request, error: Exception) -> Response:
    if isinstance(error, InvalidInputError):
        return problem_response(request, 422, str(error), error.problems)
    if isinstance(error, NotFoundError):
        return problem_response(request, 404, str(error))
    if isinstance(error, ConflictError):
        return problem_response(request, 409, str(error))
    if isinstance(error, (UnavailableError, DatabaseError)):
        return problem_response(request, 503, str(error), headers={"Retry-After": str(RETRY_SECONDS)})
    return await _unexpected(request, error)


async def _validation_error(request: Request, error: Exception) -> Response:
    """What FastAPI itself found: query, path and header parameters, and the fields of a body."""
    if not isinstance(error, RequestValidationError):
        raise error
    found: list[Problem] = []
    body = [detail | {"loc": detail["loc"][1:]} for detail in error.errors() if detail["loc"][0] == "body"]
    if body:
        found += validation.problems(body, _body_model(request), error.body)
    for detail in error.errors():
        if detail["loc"][0] != "body":
            where = ".".join(shown(part) for part in detail["loc"][1:])
            found.append(validation.problem(where, detail))
    return problem_response(request, 422, "\n".join(map(str, found)), found)


def _body_model(request: Request) -> type[BaseModel]:
    field = request.scope["route"].body_field
    annotation = field.field_info.annotation if field else None
    return annotation if isinstance(annotation, type) and issubclass(annotation, BaseModel) else BaseModel


async def _http_error(request: Request, error: Exception) -> Response:
    if not isinstance(error, HTTPException):
        raise error
    detail = str(error.detail)
    if error.status_code == HTTPStatus.NOT_FOUND and detail == HTTPStatus.NOT_FOUND.phrase:
        detail = f"there is nothing at {shown(request.url.path)}; see /docs for what there is"
    if error.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
        detail = f"{request.method} is not possible here; see /docs for what is"
    return problem_response(request, error.status_code, detail, headers=error.headers)


async def _unexpected(request: Request, error: Exception) -> Response:
    log.error("%s %s failed", request.method, request.url.path, exc_info=error)
    return problem_response(request, 500, "drivecal made a mistake; its log says more")

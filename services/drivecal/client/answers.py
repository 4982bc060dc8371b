"""HTTP answers: without what steers a terminal, and their errors as drivecal's own exceptions."""

import codecs
import json
import re
from collections.abc import Iterable, Iterator
from http import HTTPStatus

import httpx

from drivecal.domain.errors import (
    ConflictError,
    DrivecalError,
    InvalidInputError,
    NotAuthorisedError,
    NotFoundError,
    Problem,
    UnavailableError,
)

PROXY = {HTTPStatus.BAD_GATEWAY, HTTPStatus.SERVICE_UNAVAILABLE, HTTPStatus.GATEWAY_TIMEOUT}
"""Answers of a proxy whose server is away."""
GATEWAY = PROXY | {HTTPStatus.TOO_MANY_REQUESTS}


_STEERING = re.compile(
    rb"\\\\"  # a backslash in a text, so that what follows is no escape
    rb"|\\u(?:00(?:0[0-8bcef]|1[0-9a-f]|7f|[89][0-9a-f])|200[ef]|202[a-e]|206[6-9])"
    rb"|\x7f|\xc2[\x80-\x9f]|\xe2\x80[\x8e\x8f\xaa-\xae]|\xe2\x81[\xa6-\xa9]",
    re.IGNORECASE,
)
"""Control characters but tab and line ends, and marks that change the direction of text, in JSON: escaped or as UTF-8."""


def harmless(content: bytes) -> bytes:
    """Returns a JSON text with a replacement character for each that a terminal would obey: names and messages come from others."""
    return _STEERING.sub(lambda match: match[0] if match[0] == b"\\\\" else "\ufffd".encode(), content)


_STEERING_TEXT = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")
"""The same characters as in `_STEERING`, in a text that escapes nothing."""


def harmless_text(pieces: Iterable[bytes]) -> Iterator[bytes]:
    """Returns a text in UTF-8 with the replacements of `harmless`. Its pieces may end within a character."""
    decoder = codecs.getincrementaldecoder("utf-8")(errors="replace")
    for piece in pieces:
        yield _STEERING_TEXT.sub("\ufffd", decoder.decode(piece)).encode()
    yield decoder.decode(b"", final=True).encode()


def unreachable(url: str, error: Exception) -> UnavailableError:
    """Returns the error of a missing answer, with the address and the remedy."""
    reason = str(error) or type(error).__name__
    if isinstance(error, httpx.ReadTimeout):
        return UnavailableError(f"the server at {url} did not answer in time; it may be busy: try again")
    if "CERTIFICATE_VERIFY" in reason:
        remedy = "set SSL_CERT_FILE to the file of the certificate that signed it"
        return UnavailableError(f"the certificate of {url} is not trusted ({reason}); {remedy}")
    return UnavailableError(
        f"no drivecal server answers at {url} ({reason}); start one with `drivecal serve`, or set DRIVECAL_URL or --url"
    )


def raise_for(response: httpx.Response, kind: str, identifier: str) -> None:
    """Raises the error that the problem document of a bad answer describes.

    `kind` and `identifier` name the requested object, for NotFoundError.
    """
    if response.is_success or response.status_code == HTTPStatus.NOT_MODIFIED:
        return
    document = _document(response)
    detail = str(document.get("detail") or document.get("title") or f"HTTP {response.status_code}")
    if response.status_code == HTTPStatus.NOT_FOUND and kind:
        missing = f"{NotFoundError(kind, identifier)}; "
        raise NotFoundError(kind, identifier, detail.removeprefix(missing) if detail.startswith(missing) else "")
    if response.status_code == HTTPStatus.CONFLICT:
        raise ConflictError(detail)
    if response.status_code == HTTPStatus.UNAUTHORIZED:
        raise NotAuthorisedError(_unknown(response))
    if response.status_code in {HTTPStatus.FORBIDDEN, HTTPStatus.MISDIRECTED_REQUEST}:
        raise NotAuthorisedError(f"the server at {_server(response)} refuses: {detail}")
    if response.status_code in GATEWAY:
        raise UnavailableError(detail)
    if response.is_client_error:
        raise InvalidInputError(*(_problems(document) or [Problem("", detail)]))
    raise DrivecalError(f"the server at {_server(response)} failed: {detail}")


def _server(response: httpx.Response) -> httpx.URL:
    return response.url.copy_with(path="/", query=None)


def _unknown(response: httpx.Response) -> str:
    if "authorization" in response.request.headers:
        return f"the server at {_server(response)} does not know this token; give DRIVECAL_TOKEN one that is in its tokens file"
    return f"the server at {_server(response)} asks for a token; set DRIVECAL_TOKEN to one that is in its tokens file"


def _document(response: httpx.Response) -> dict[str, object]:
    try:
        document = json.loads(harmless(response.content))
    except ValueError:
        document = None
    if not isinstance(document, dict) or "status" not in document:
        if response.status_code == HTTPStatus.REQUEST_ENTITY_TOO_LARGE:
            message = f"a proxy before the server at {_server(response)} refuses a body of this size"
            raise InvalidInputError(Problem("", message, "raise its limit, e.g. client_max_body_size 64m"))
        if response.status_code == HTTPStatus.GATEWAY_TIMEOUT:
            seconds = response.elapsed.total_seconds()
            message = f"a proxy before the server at {_server(response)} gave up after {seconds:.0f} s"
            raise UnavailableError(f"{message}; raise its read timeout, e.g. proxy_read_timeout 300s")
        if response.status_code in PROXY:
            message = f"a proxy answers HTTP {response.status_code} in the place of the server at {response.url}"
            raise UnavailableError(f"{message}; it may be starting: try again")
        raise UnavailableError(
            f"the server at {response.url} is not drivecal (HTTP {response.status_code}); check DRIVECAL_URL or --url"
        )
    return document


def _problems(document: dict[str, object]) -> list[Problem]:
    errors = document.get("errors")
    if not isinstance(errors, list):
        return []
    return [
        Problem(str(error.get("field", "")), str(error.get("message", "")), str(error.get("remedy", "")))
        for error in errors
        if isinstance(error, dict)
    ]

"""The client's requests: patience with busy and restarting servers, and answers as models."""

import codecs
import json
import re
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from http import HTTPStatus
from typing import Any, Self, TypeVar
from urllib.parse import quote

import httpx
from pydantic import BaseModel, ValidationError

from drivecal.client.documents import Document, plain, query_of
from drivecal.configuration.tokens import is_this_machine
from drivecal.contracts.strict_json import check_plain
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
NOTHING = "there is nothing at "
"""Beginning of the server's answer to an unknown address."""
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
    reason, url = str(error) or type(error).__name__, _shown(url)
    if isinstance(error, httpx.ReadTimeout):
        return UnavailableError(f"the server at {url} did not answer in time; it may be busy: try again")
    if "CERTIFICATE_VERIFY" in reason:
        remedy = "set SSL_CERT_FILE to the file of the certificate that signed it"
        return UnavailableError(f"the certificate of {url} is not trusted ({reason}); {remedy}")
    if isinstance(error, LOST):
        return UnavailableError(f"the connection to {url} broke ({reason}); try again, or correct DRIVECAL_URL or --url")
    return UnavailableError(
        f"no drivecal server answers at {url} ({reason}); start one with `drivecal serve`, or set DRIVECAL_URL or --url"
    )


def _shown(url: object) -> str:
    """Returns an address without the password that it may hold."""
    return re.sub(r"(?<=//).*@", "", str(url))


def raise_for(response: httpx.Response, kind: str, identifier: str) -> None:
    """Raises the error that the problem document of a bad answer describes.

    `kind` and `identifier` name the requested object, for NotFoundError.
    """
    if response.is_success or response.status_code == HTTPStatus.NOT_MODIFIED:
        return
    document = _document(response)
    detail = str(document.get("detail") or document.get("title") or f"HTTP {response.status_code}")
    if response.status_code == HTTPStatus.NOT_FOUND and kind and ("/" in identifier or not detail.startswith(NOTHING)):
        said = re.fullmatch(r"there is no (.+?) '(.*?)'(?:; (.*))?", detail)
        raise NotFoundError(*(said.groups("") if said else (kind, identifier)))
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


def _server(response: httpx.Response) -> str:
    return _shown(response.url.copy_with(path="/", query=None))


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
            message = f"a proxy answers HTTP {response.status_code} in the place of the server at {_shown(response.url)}"
            raise UnavailableError(f"{message}; it may be starting: try again")
        raise UnavailableError(
            f"{_shown(response.url)} is not drivecal (HTTP {response.status_code}); check DRIVECAL_URL or --url"
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


Answer = TypeVar("Answer", bound=BaseModel)

KINDS = {
    "campaigns": "campaign",
    "comparisons": "comparison",
    "evaluations": "evaluation",
    "influence-maps": "influence map",
    "problems": "problem",
    "results": "results",
}
"""Names of the collections' items in messages."""
ATTEMPTS_TO_CONNECT = 3
SECONDS_TO_CONNECT = 0.5
BROKEN_ANSWERS = 2
"""Broken connections in a call before the server counts as unreachable; a restart breaks some."""
SECONDS_TO_RESTART = 1.0
LOST = (httpx.ReadError, httpx.WriteError, httpx.CloseError, httpx.RemoteProtocolError, httpx.ReadTimeout, httpx.WriteTimeout)
"""Errors after which a call may have reached the server."""
ASKING = {HTTPStatus.TOO_MANY_REQUESTS, HTTPStatus.SERVICE_UNAVAILABLE}
SLOW_SECONDS = 300.0
"""Time within which a whole table has to begin, and to continue: a large ranking takes a while."""
PATIENCE_SECONDS = 30.0
"""Total wait for a server that asks to try again, in calls that are safe to repeat. Answers that took longer are not asked for again."""


class Transport:
    """Requests to the server at `url`."""

    def __init__(self, url: str, token: str | None, timeout: float, transport: httpx.BaseTransport | None = None) -> None:
        self.url = url.rstrip("/")
        if token and not (token.isascii() and token.isprintable() and " " not in token):
            message = "it has a blank, a line end or a character beyond ASCII"
            raise InvalidInputError(Problem("token", message, "give the token alone"))  # not in the message: it is a secret
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._answered = False
        # Proxies of the environment are for other machines: they do not reach a server on this one.
        try:
            if transport is None and is_this_machine(httpx.URL(self.url).host):
                transport = httpx.HTTPTransport(verify=self.url.startswith("https:"))  # certificates take 50 ms to load
            self._http = httpx.Client(base_url=self.url, timeout=timeout, headers=headers, transport=transport)
        except httpx.InvalidURL:
            raise unreachable(self.url, ValueError("it is no web address")) from None
        except (ImportError, ValueError) as error:  # of a proxy that httpx does not know
            remedy = "correct it in the environment, or take it away"
            raise InvalidInputError(Problem("ALL_PROXY, HTTP_PROXY or HTTPS_PROXY", str(error), remedy)) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._http.close()

    def _get(self, model: type[Answer], *place: str, **query: Any) -> Answer:
        return self._call(model, "GET", *place, query=query)

    def _call(self, model: type[Answer], method: str, *place: str, **content: Any) -> Answer:
        return self._answer(self._request(method, place, **content), model, place)

    def _post(
        self, model: type[Answer], *place: str, document: Document | None = None, key: str | None = None, **query: Any
    ) -> Answer:
        if key and not (isinstance(key, str) and key.isascii() and key.isprintable()):
            raise InvalidInputError(Problem("key", f"{key!r} cannot be a key", "give letters and digits"))
        headers = {"Idempotency-Key": key} if key else {}
        # Actions on a campaign (no document) and counting (validate_only) may be repeated as well.
        again = document is None or bool(key or query)
        content = None if document is None else plain(document)
        return self._answer(self._request("POST", place, query, headers, content, again=again), model, place)

    def _request(
        self,
        method: str,
        place: Sequence[str],
        query: Mapping[str, Any] | None = None,
        headers: Mapping[str, str] | None = None,
        document: Mapping[str, Any] | None = None,
        content: bytes | None = None,
        *,
        again: bool = True,
    ) -> httpx.Response:
        """Returns the answer to a call. `again`: it may be repeated. It is, while the server asks for that, breaks off or starts again, for
        up to PATIENCE_SECONDS. Without it only a connection that was never made is tried again, so that nothing is done twice."""
        params, path = query_of(query or {}), path_of(place)
        waited, answering, broken, refused = 0.0, 0.0, 0, 0
        while True:
            began = time.monotonic()
            try:
                response = self._http.request(method, path, params=params, headers=headers, json=document, content=content)
            except (httpx.RequestError, httpx.InvalidURL) as error:
                is_lost, is_refused = isinstance(error, LOST), isinstance(error, httpx.ConnectError)
                broken, refused = broken + is_lost, refused + is_refused
                starts = is_refused and (broken > 0 or self._answered)
                if is_refused and refused < ATTEMPTS_TO_CONNECT:
                    pause = SECONDS_TO_CONNECT * (refused - 1)
                elif again and (is_lost or starts) and broken <= BROKEN_ANSWERS and waited < PATIENCE_SECONDS:
                    pause = SECONDS_TO_RESTART
                else:
                    gone = unreachable(self.url, error)
                    if broken and again and "Idempotency-Key" in (headers or {}):
                        message = f"{gone}; it may be queued all the same: see `drivecal list` before you submit it again"
                        raise UnavailableError(message) from error
                    raise gone from error
            except ValueError as error:
                check_plain(document)
                raise InvalidInputError(Problem("", str(error), "give finite numbers, and valid Unicode text")) from error
            else:
                self._answered = True
                answering += time.monotonic() - began  # a proxy that gives up does so after a minute, each time
                asked = _pause(response) if again else None
                if asked is None or max(waited + asked, answering) > PATIENCE_SECONDS:
                    return response
                pause = asked
            time.sleep(pause)
            waited += pause

    def _pieces(self, path: str, query: Mapping[str, Any], kind: str, identifier: str) -> Iterator[bytes]:
        """Yields a long answer in pieces as they arrive; asks again while the server asks for it, as `_request`.

        Does not ask again if a proxy gave up on the server: it would begin the same work anew. `kind`, `identifier`: as of `raise_for`.
        """
        params, waited = query_of(query) or None, 0.0
        timeout = httpx.Timeout(self._http.timeout.connect, read=SLOW_SECONDS)
        while True:
            try:
                with self._http.stream("GET", path, params=params, timeout=timeout) as response:
                    if not response.is_success:
                        response.read()
                    asked = None if response.status_code == HTTPStatus.GATEWAY_TIMEOUT else _pause(response)
                    if asked is None or waited + asked > PATIENCE_SECONDS:
                        raise_for(response, kind, identifier)
                        if "format" in query:  # a report is a page
                            self._refuse_page(response)
                        yield from response.iter_bytes()
                        return
            except httpx.RequestError as error:
                raise unreachable(self.url, error) from error
            time.sleep(asked)
            waited += asked

    def _refuse_page(self, response: httpx.Response) -> None:
        """Raises UnavailableError for a page in the place of a file: a proxy may ask for a password."""
        if "html" in response.headers.get("content-type", ""):
            raise self._strange()

    def _answer(self, response: httpx.Response, model: type[Answer], place: Sequence[str]) -> Answer:
        raise_for(response, *named(place))
        try:
            return model.model_validate_json(harmless(response.content))
        except ValidationError as error:
            raise self._strange() from error

    def _strange(self) -> UnavailableError:
        return UnavailableError(
            f"{_shown(self.url)} answers in a form that this drivecal does not know; are both of one version?"
        )


def path_of(parts: Sequence[str]) -> str:
    """Returns the URL's path of a place in the API. Raises InvalidInputError for `..` and the like, which would name another place."""
    for part in parts:
        if part in {"", ".", ".."}:
            raise InvalidInputError(Problem(repr(part), "it names nothing", "give an identifier"))
    return "/api/v1/" + "/".join(quote(str(part), safe="", errors="replace") for part in parts)  # cells have numbers


def named(place: Sequence[str]) -> tuple[str, str]:
    """Returns the kind and the identifier of the object at a place; both empty for a list."""
    return (KINDS[place[0]], str(place[1])) if len(place) > 1 else ("", "")


def _pause(response: httpx.Response) -> float | None:
    """Returns the seconds after which the server, or a proxy before it, wants to be asked again; None if it does not."""
    given = response.headers.get("retry-after", "")
    if response.status_code in ASKING and given.isascii() and given.isdecimal() and len(given) < 10:
        return max(0.1, float(given))
    is_drivecals = response.headers.get("content-type", "").startswith("application/problem+json")
    return SECONDS_TO_RESTART if response.status_code in PROXY and not is_drivecals else None

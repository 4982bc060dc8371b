"""The client's requests: patience with busy and restarting servers, and answers as models."""

import time
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any, Self, TypeVar
from urllib.parse import quote

import httpx
from pydantic import BaseModel, ValidationError

from drivecal.client.answers import harmless, raise_for, unreachable
from drivecal.client.documents import Document, plain
from drivecal.domain.errors import UnavailableError

Answer = TypeVar("Answer", bound=BaseModel)

KINDS = {"campaigns": "campaign", "evaluations": "evaluation", "influence-maps": "influence map", "problems": "problem"}
"""Names of the collections' items in messages."""
ATTEMPTS_TO_CONNECT = 3
BROKEN_ANSWERS = 2
"""Broken connections in a call before the server counts as unreachable; a restart breaks some."""
SECONDS_TO_RESTART = 1.0
BROKEN_OFF = (httpx.ReadError, httpx.WriteError, httpx.CloseError, httpx.RemoteProtocolError)
PATIENCE_SECONDS = 30.0
"""Total wait for a server that asks to try again, in calls that are safe to repeat."""


class Transport:
    """Requests to the server at `url`."""

    def __init__(self, url: str, token: str | None, timeout: float) -> None:
        self.url = url.rstrip("/")
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        # Only a connection that was never made is tried again, so that nothing is ever done twice.
        transport = httpx.HTTPTransport(retries=ATTEMPTS_TO_CONNECT - 1)
        self._http = httpx.Client(base_url=self.url, timeout=timeout, transport=transport, headers=headers)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._http.close()

    def _full_place(self, place: Sequence[str]) -> Sequence[str]:
        """Returns a place with full ids."""
        return place

    def _get(self, model: type[Answer], *place: str, **query: Any) -> Answer:
        return self._answer(self._request("GET", place, query=query), model, place)

    def _post(
        self, model: type[Answer], *place: str, document: Document | None = None, key: str | None = None, **query: Any
    ) -> Answer:
        headers = {"Idempotency-Key": key} if key else {}
        # Actions on a campaign (no document) and counting (validate_only) may be repeated as well.
        ask = self._once if document is not None and not key and not query else self._request
        content = None if document is None else plain(document)
        return self._answer(ask("POST", place, query=query, headers=headers, document=content), model, place)

    def _request(self, method: str, place: Sequence[str], **content: Any) -> httpx.Response:
        """Repeats a call that is safe to repeat while the server asks for it or breaks off, for up to PATIENCE_SECONDS."""
        waited, broken = 0.0, 0
        while True:
            try:
                response = self._once(method, place, **content)
            except UnavailableError as error:
                broken += 1
                if broken > BROKEN_ANSWERS or not isinstance(error.__cause__, BROKEN_OFF):
                    raise
                pause = SECONDS_TO_RESTART
            else:
                asked = _pause(response)
                if asked is None or waited + asked > PATIENCE_SECONDS:
                    return response
                pause = asked
            time.sleep(pause)
            waited += pause

    def _once(
        self,
        method: str,
        place: Sequence[str],
        query: Mapping[str, Any] | None = None,
        headers: Mapping[str, str] | None = None,
        document: Mapping[str, Any] | None = None,
        content: bytes | None = None,
    ) -> httpx.Response:
        params = {name: value for name, value in (query or {}).items() if value is not None}
        try:
            return self._http.request(
                method, path_of(self._full_place(place)), params=params, headers=headers, json=document, content=content
            )
        except (httpx.TransportError, httpx.InvalidURL) as error:
            raise unreachable(self.url, error) from error

    def _answer(self, response: httpx.Response, model: type[Answer], place: Sequence[str]) -> Answer:
        raise_for(response, *named(place))
        try:
            return model.model_validate_json(harmless(response.content))
        except ValidationError as error:
            raise self._strange() from error

    def _strange(self) -> UnavailableError:
        return UnavailableError(f"{self.url} answers in a form that this drivecal does not know; are both of one version?")


def path_of(parts: Sequence[str]) -> str:
    """Returns the URL's path of a place in the API."""
    return "/api/v1/" + "/".join(quote(part, safe="") for part in parts)


def named(place: Sequence[str]) -> tuple[str, str]:
    """Returns the kind and the identifier of the object at a place; both empty for a list."""
    return (KINDS[place[0]], place[1]) if len(place) > 1 else ("", "")


def _pause(response: httpx.Response) -> float | None:
    """Returns the seconds after which the server wants to be asked again; None if it does not."""
    if response.status_code not in {HTTPStatus.TOO_MANY_REQUESTS, HTTPStatus.SERVICE_UNAVAILABLE}:
        return None
    given = response.headers.get("retry-after", "")
    return max(0.1, float(given)) if given.isascii() and given.isdecimal() and len(given) < 10 else None

"""Authorisation of single requests: the application behind it answers 200 to everything."""

import asyncio
from collections.abc import Sequence
from itertools import product
from typing import Any
from unittest.mock import Mock

import pytest
import structlog
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Message, Receive, Scope, Send

from drivecal.api.http import sessions
from drivecal.api.http.authorisation import ANYBODY, Authorisation, is_loopback_host
from drivecal.api.routes import page_session
from drivecal.configuration.pushing import OFF
from drivecal.configuration.tokens import TokenFile, parse

ANNA, PLANT = b"anna-0123456789abcdef", b"plant-0123456789abcdef"
Header = tuple[bytes, bytes]
HOST: Header = (b"host", b"localhost:8000")


class Fixed(TokenFile):
    """Tokens that are in no file."""

    def __init__(self) -> None:
        self.tokens = tuple(parse(b"anna write " + ANNA + b"\nplant read " + PLANT, "tokens")[0])

    def _refresh(self) -> None:
        return None


def ask(
    tokens: TokenFile | None,
    method: str = "GET",
    path: str = "/api/v1/campaigns",
    headers: Sequence[Header] = (),
    query: bytes = b"",
) -> tuple[int, dict[str, str], Any]:
    """Status, headers, and whom the application behind was told that it serves."""
    sent: list[Message] = []
    told: list[Any] = []

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        del receive
        told.append(scope["state"]["token"])
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def receive() -> Message:
        raise AssertionError("nothing is read")

    async def send(message: Message) -> None:
        sent.append(message)

    scope: Scope = {
        "type": "http",
        "method": method,
        "path": path,
        "query_string": query,
        "headers": list(headers),
        "state": {},
    }
    asyncio.run(Authorisation(app, tokens)(scope, receive, send))
    answer = {name.decode(): value.decode() for name, value in sent[0]["headers"]}
    return sent[0]["status"], answer, told[0] if told else None


def bearer(token: bytes, scheme: bytes = b"Bearer ") -> list[Header]:
    return [(b"authorization", scheme + token)]


@pytest.mark.parametrize(
    "headers", [bearer(ANNA), bearer(ANNA, b"bearer "), bearer(ANNA, b"BEARER   "), bearer(ANNA + b"  "), bearer(PLANT)]
)
def test_who_shows_a_token_is_let_in(headers: list[Header]) -> None:
    status, _, token = ask(Fixed(), headers=headers)
    assert (status, token.name) == (200, "plant" if PLANT in headers[0][1] else "anna")


REFUSED = [
    [],
    bearer(b""),
    bearer(b"wrong-0123456789abcdef"),
    bearer(ANNA[:-1]),
    bearer(ANNA + b"\xff"),
    bearer("änna-0123456789abcdef".encode()),
    bearer(b"\xff\xfe" * 10),
    bearer(b"a" * 60_000),
    bearer(ANNA, b"Basic "),
    bearer(ANNA, b""),
    bearer(ANNA, b"Bearer"),
    bearer(ANNA, b"Bearer\t"),
    bearer(b'"' + ANNA + b'"'),
    bearer(ANNA + b"," + ANNA),
    [*bearer(ANNA), *bearer(ANNA)],
    [(b"x-authorization", b"Bearer " + ANNA)],
    [(b"cookie", b"token=" + ANNA)],
]


@pytest.mark.parametrize("headers", REFUSED, ids=lambda headers: str(headers)[:50])
def test_who_shows_none_is_not(headers: list[Header]) -> None:
    paths = ["/api/v1/campaigns", "/nothing", "/openapi.json", "/metrics", "/healthz/", "//healthz", "/Healthz"]
    for method, path in product(["GET", "POST", "TRACE"], paths):
        status, answer, told = ask(Fixed(), method, path, headers)
        assert (status, told) == (401, None), (method, path)
        assert answer["www-authenticate"].startswith('Bearer realm="drivecal"')
        assert ("invalid_token" in answer["www-authenticate"]) == any(name == b"authorization" for name, _ in headers)
        assert answer["content-type"] == "application/problem+json"


@pytest.mark.parametrize("path", ["/healthz", "/readyz"])
def test_supervisors_need_no_token_but_may_show_one(path: str) -> None:
    assert ask(Fixed(), path=path) == (200, {}, None)
    assert ask(Fixed(), path=path, headers=bearer(b"wrong"))[::2] == (200, None)
    assert ask(Fixed(), path=path, headers=bearer(PLANT))[2].name == "plant"


@pytest.mark.parametrize("method", ["POST", "PUT", "PATCH", "DELETE", "BREW"])
def test_a_token_that_may_only_read_changes_nothing(method: str) -> None:
    status, answer, told = ask(Fixed(), method, headers=bearer(PLANT))
    assert (status, told) == (403, None)
    assert "insufficient_scope" in answer["www-authenticate"]
    assert ask(Fixed(), method, headers=bearer(ANNA))[0] == 200
    assert ask(Fixed(), "HEAD", headers=bearer(PLANT))[0] == 200


@pytest.mark.parametrize(
    ("path", "query", "status"),
    [
        ("/api/v1/campaigns", b"validate_only=true", 200),
        ("/api/v1/campaigns", b"validate_only=false", 403),
        ("/api/v1/campaigns", b"validate_only=true&validate_only=false", 403),
        ("/api/v1/campaigns", b"validate_only=false&validate_only=true", 403),
        ("/api/v1/campaigns", b"validate_only=TRUE", 403),
        ("/api/v1/evaluations", b"validate_only=true", 403),
        ("/api/v1/campaigns/x/cancel", b"validate_only=true", 403),
    ],
)
def test_a_token_that_may_only_read_may_check_a_campaign(path: str, query: bytes, status: int) -> None:
    assert ask(Fixed(), "POST", path, bearer(PLANT), query)[0] == status


def test_without_tokens_anybody_on_this_machine_is_let_in() -> None:
    assert ask(None, "POST", headers=[HOST]) == (200, {}, ANYBODY)


@pytest.mark.parametrize(
    "host", ["localhost", "LOCALHOST:1", "127.0.0.1", "127.0.0.1:8000", "127.1.2.3:5", "[::1]", "[::1]:8000"]
)
def test_loopback_has_many_names(host: str) -> None:
    assert is_loopback_host(host)


@pytest.mark.parametrize(
    "host",
    [
        *(
            "",
            "example.org",
            "example.org:8000",
            "localhost.example.org",
            "127.0.0.1.example.org",
            "192.0.2.1",
            "[::2]",
            "0.0.0.0",
        ),
        *(
            "localhost:80a",
            "localhost:",
            "127.0.0.1:٣",
            "localhost@example.org",
            "user:pass@localhost",
            "::1:8000x",
            "[::1",
            "2130706433",
        ),
    ],
)
def test_a_name_that_a_stranger_may_have_given_to_loopback_is_none(host: str) -> None:
    assert not is_loopback_host(host) or host == "localhost:"
    status, answer, told = ask(None, headers=[(b"host", host.encode())])
    if host != "localhost:":
        assert (status, told, answer["content-type"]) == (421, None, "application/problem+json")


def test_without_tokens_a_host_must_be_named_and_named_once() -> None:
    assert ask(None)[0] == 421
    assert ask(None, headers=[HOST, HOST])[0] == 421
    for host in (b"127.0.0.1%evil", b"[::1%evil]", b"[::1%25lo]:8000", b"127.0.0.1%evil:80"):
        assert ask(None, headers=[(b"host", host)])[0] == 421


@pytest.mark.parametrize(
    ("origin", "status"),
    [
        (b"http://localhost:8000", 200),
        (b"https://localhost:8000", 200),
        (b"http://localhost:3000", 403),
        (b"http://127.0.0.1:8000", 403),
        (b"https://example.org", 403),
        (b"null", 403),
        (b"", 403),
        (b"\xff", 403),
    ],
)
def test_without_tokens_a_web_page_of_another_origin_changes_nothing(origin: bytes, status: int) -> None:
    headers = [HOST, (b"origin", origin)]
    for method in ("POST", "DELETE"):
        result, answer, _ = ask(None, method, "/api/v1/campaigns/x/cancel", headers)
        assert result == status
        assert not [name for name in answer if name.startswith("access-control-")]
    assert ask(None, "GET", headers=headers)[0] == 200


OWN, FOREIGN = (b"origin", b"http://localhost:8000"), (b"origin", b"http://localhost:9000")


def cookie(token: bytes) -> Header:
    """The session that `token` was given."""
    result = Fixed().find(token)
    assert result is not None
    return b"cookie", f"drivecal-session-8000={sessions.begin(result)}".encode()


def test_a_session_stands_for_its_token() -> None:
    assert ask(Fixed(), headers=[HOST, cookie(PLANT)])[2].name == "plant"
    assert ask(Fixed(), "POST", "/api/v1/campaigns/x/cancel", [HOST, OWN, cookie(ANNA)])[0] == 200
    assert ask(Fixed(), "POST", "/api/v1/campaigns/x/cancel", [HOST, OWN, cookie(PLANT)])[0] == 403


@pytest.mark.parametrize("origin", [[], [FOREIGN], [(b"origin", b"null")]])
def test_a_page_of_another_origin_changes_nothing_with_a_session(origin: list[Header]) -> None:
    """A page on another port of this machine counts as the same site: its requests carry the cookie."""
    assert ask(Fixed(), "POST", "/api/v1/campaigns/x/cancel", [HOST, *origin, cookie(ANNA)])[0] == 403
    assert ask(Fixed(), "DELETE", "/api/v1/session", [HOST, *origin, cookie(ANNA)])[0] == 403


@pytest.mark.parametrize("site", [b"same-site", b"cross-site"])
def test_a_page_of_another_origin_loads_nothing_with_a_session(site: bytes) -> None:
    """Images and frames of a page on another port carry the cookie, and some GET requests start simulations."""
    trace, fetched = "/api/v1/evaluations/1/trace", (b"sec-fetch-site", site)
    frame, link = (b"sec-fetch-dest", b"iframe"), (b"sec-fetch-dest", b"document")
    clicked = (b"sec-fetch-user", b"?1")
    assert ask(Fixed(), "GET", trace, [HOST, fetched, cookie(ANNA)])[0] == 403
    assert ask(Fixed(), "GET", trace, [HOST, fetched, clicked, frame, cookie(ANNA)])[0] == 403
    assert ask(Fixed(), "GET", trace, [HOST, fetched, clicked, link, cookie(ANNA)])[0] == 200
    for own in (b"same-origin", b"none"):
        assert ask(Fixed(), "GET", trace, [HOST, (b"sec-fetch-site", own), cookie(ANNA)])[0] == 200


def forged(name: str, value: str) -> Header:
    """A cookie that the server never set."""
    return b"cookie", f"{name}={value}".encode()


def test_a_session_that_was_not_given_or_is_over_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    value = cookie(ANNA)[1].decode().partition("=")[2]
    end, signature, name = value.split("-", 2)
    monkeypatch.setattr(sessions, "SECONDS", 0)
    wrong = [
        cookie(ANNA),
        forged("drivecal-session-9000", value),
        forged("drivecal-session-8000", f"{int(end) + 1}-{signature}-{name}"),
        forged("drivecal-session-8000", f"{end}-{signature}-plant"),
        forged("drivecal-session-8000", f"{end}-{signature}-nobody"),
        forged("drivecal-session-8000", f"{end}-{'0' * 64}-{name}"),
        forged("drivecal-session-8000", f"{end}-{'é' * 20}-{name}"),
        forged("drivecal-session-8000", "x" * 5_000),
        forged("drivecal-session-8000", "--"),
    ]
    assert [ask(Fixed(), headers=[HOST, item])[0] for item in wrong] == [401] * len(wrong)
    assert ask(Fixed(), headers=[HOST, forged("drivecal-session-8000", value)])[0] == 200


def test_who_may_only_read_may_log_in_and_out() -> None:
    shown = (b"authorization", b"Bearer " + PLANT)
    assert ask(Fixed(), "POST", "/api/v1/session", [HOST, shown])[0] == 200
    assert ask(Fixed(), "DELETE", "/api/v1/session", [HOST, OWN, cookie(PLANT)])[0] == 200


def test_the_log_is_told_whose_token_it_is_and_never_the_token() -> None:
    noted: list[dict[str, Any]] = []

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        del scope, receive, send
        noted.append(structlog.contextvars.get_contextvars())

    async def never(*_: object) -> Any:
        raise AssertionError("nothing is read or sent")

    scope = {"type": "http", "method": "POST", "path": "/", "query_string": b"", "headers": bearer(ANNA), "state": {}}
    asyncio.run(Authorisation(app, Fixed())(scope, never, never))
    assert noted[0]["token"] == "anna"
    assert "0123456789abcdef" not in str(noted)


def test_a_session_begins_and_ends_without_a_host_as_in_http_1_0() -> None:
    (token,) = parse(b"anna write anna-0123456789abcdef", "tokens")[0]
    scope = {"type": "http", "headers": [], "state": {"token": token}, "app": Mock(**{"state.pushing": OFF})}
    request, begun, ended = Request(scope), Response(), Response()
    page_session.begin_session(request, begun)
    page_session.end_session(request, ended)
    assert [answer.headers["set-cookie"].partition("=")[0] for answer in (begun, ended)] == ["drivecal-session"] * 2

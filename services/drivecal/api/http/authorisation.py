"""Authorisation in front of everything else, so that no route is reached without it.

With a tokens file every request needs `Authorization: Bearer TOKEN` or the session of a token. Requests that change something need a token
that may write; with a session, they must also come from a page of this very origin, and pages of other origins load no answers. Without
a tokens file the server listens on loopback only and refuses web pages in the user's browser: names that resolve to 127.0.0.1 (DNS
rebinding) by the Host header, posts of other pages by the Origin header, images and frames of other pages, which have none,
by Sec-Fetch-Site. No answer ever carries a CORS header.
"""

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from drivecal.api.http import sessions
from drivecal.api.http.problems import problem_response
from drivecal.api.responses import ROOT
from drivecal.configuration import logs
from drivecal.configuration.pushing import FILE, HEADER, Pushing, signed_digest
from drivecal.configuration.tokens import Token, TokenFile, is_this_machine

OPEN = {"/healthz", "/readyz"}
"""Paths for supervisors and load balancers, which have no token and learn only whether the service works."""
PAGE = "/page/"
"""Path of the page's files, which hold only the program; the page itself asks for a token."""
HELP = "/help"
"""Path of the documentation."""
READING = {"GET", "HEAD", "OPTIONS"}
FOREIGN = {"cross-site", "same-site"}
"""Values of Sec-Fetch-Site in requests of pages of other origins."""
CHECKED = {f"{ROOT}/campaigns", f"{ROOT}/comparisons"}
"""Paths at which `validate_only=true` stores nothing."""
LOOK_UP = f"{ROOT}/results/lookup"
"""A question of many sets, which stores nothing."""
ANYBODY = Token("anybody", may_write=True, digest=b"", is_admin=True)
"""The client of a server without tokens."""
CHALLENGE = 'Bearer realm="drivecal"'


class Authorisation:
    """ASGI middleware. `request.state.token`: the presented token, ANYBODY without tokens, or None on open routes without one.
    `request.state.is_admitted()`: whether it still is valid; a long connection asks before it sends."""

    def __init__(self, app: ASGIApp, tokens: TokenFile | None) -> None:
        self.app = app
        self.tokens = tokens

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes allowed requests on."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        request = Request(scope)
        request.state.is_admitted = lambda: self.tokens is None or _holder(request, self.tokens) is not None
        refusal = self._admit_by_origin(request) if self.tokens is None else self._admit_by_token(request, self.tokens)
        if refusal is not None:
            status, detail, headers = refusal
            await problem_response(request, status, detail, headers=headers)(scope, receive, send)
        else:
            await self.app(scope, receive, send)

    def _admit_by_token(self, request: Request, tokens: TokenFile) -> tuple[int, str, dict[str, str]] | None:
        """Returns status, sentence and headers of a refusal; None if the request may go on."""
        given = request.headers.getlist("authorization")
        request.state.token = token = _holder(request, tokens)
        logs.note(token=None if token is None else token.name)
        if _is_open(request):
            return None
        if token is None and not given:
            return 401, "this server asks for a token: send Authorization: Bearer TOKEN", {"WWW-Authenticate": CHALLENGE}
        if token is None:
            wrong = CHALLENGE + ', error="invalid_token"'
            detail = "this server does not know that token; it takes Authorization: Bearer TOKEN"
            return 401, detail, {"WWW-Authenticate": wrong}
        if not given and _is_embedded(request):
            return 403, "with a session this server gives web pages of other origins nothing; open the address itself", {}
        if request.method in READING or _only_checks(request):
            return None
        if not given and not sessions.same_origin(request.headers):
            detail = (
                "with a session this server takes changes from its own page only; send Authorization: Bearer TOKEN;"
                " behind a proxy, pass the Host header on"
            )
            return 403, detail, {}
        if not token.may_write and request.scope["path"] != sessions.PATH:
            return _insufficient(token)
        return None

    def _admit_by_origin(self, request: Request) -> tuple[int, str, dict[str, str]] | None:
        request.state.token = ANYBODY
        hosts = request.headers.getlist("host")
        if len(hosts) != 1 or not is_loopback_host(hosts[0]):
            detail = "without tokens this server answers to localhost, 127.0.0.1 and [::1] only; use one of them as the address"
            return 421, detail, {}
        if request.method not in READING and "origin" in request.headers and not sessions.same_origin(request.headers):
            return 403, "without tokens this server takes no changes from web pages of other origins", {}
        if _is_embedded(request):
            return (
                403,
                "without tokens this server gives web pages of other origins nothing; type the address, or click on a link",
                {},
            )
        return None


def _is_embedded(request: Request) -> bool:
    """Returns whether a page of another origin loads an answer of the API by itself: some GET requests start simulations or processes."""
    headers = request.headers
    # One click lets a page load frames for seconds, each with Sec-Fetch-User; a followed link is a document.
    is_click = headers.get("sec-fetch-user") == "?1" and headers.get("sec-fetch-dest", "document") == "document"
    return headers.get("sec-fetch-site") in FOREIGN and not is_click and request.url.path.startswith(f"{ROOT}/")


def refuse_reader(request: Request) -> None:
    """Raises HTTPException (403) if the token may only read, for GET requests that change something."""
    token: Token = request.state.token
    if not token.may_write:
        status, detail, headers = _insufficient(token)
        raise HTTPException(status, detail, headers)


async def owner_of(request: Request) -> str | None:
    """Returns the owner of what a request submits, None on a server without tokens."""
    token: Token = request.state.token
    return None if token is ANYBODY else token.name


def refuse_others(request: Request, name: str, owner: str | None, kind: str = "campaign") -> None:
    """Raises HTTPException (403) if the token may not steer a campaign, or delete imported results, of this owner."""
    token: Token = request.state.token
    if not token.may_steer(owner):
        raise HTTPException(403, f"{kind} {name} belongs to {owner}; only {owner} or an admin may change or delete it")


def refuse_push(request: Request) -> str | None:
    """Raises HTTPException (403) if the request may not push a problem. Call it before reading the body.

    A session and pages of other origins never may. Returns the SHA-256 digest that the body must have, None on a server with tokens.
    """
    pushing: Pushing = request.app.state.pushing
    token: Token = request.state.token
    if not pushing.allowed:
        detail = "this server takes no problems; start it with DRIVECAL_ALLOW_PUSH=true, or let it listen on 127.0.0.1"
        raise HTTPException(403, detail)
    if "origin" in request.headers and not sessions.same_origin(request.headers):
        raise HTTPException(403, "no problem is taken from this web page; use `drivecal problem push`")
    if token is not ANYBODY:
        if "authorization" not in request.headers:
            raise HTTPException(403, "a session pushes no problem; send Authorization: Bearer TOKEN")
        if not token.may_push:
            detail = f"the token of {token.name} may not push problems; give one of an author (NAME author TOKEN) or admin"
            raise HTTPException(403, detail, {"WWW-Authenticate": CHALLENGE + ', error="insufficient_scope"'})
        return None
    given = request.headers.getlist(HEADER)
    digest = signed_digest(pushing.secret, given[0]) if pushing.secret is not None and len(given) == 1 else None
    if digest is None:
        detail = (
            f"without tokens this server takes problems from its own user only, who proves it by {FILE} in its home folder; nobody else"
            f" may have the right to read that file (chmod 600); type: DRIVECAL_HOME={pushing.home} drivecal problem push DIR"
        )
        raise HTTPException(403, detail)
    return digest


def _insufficient(token: Token) -> tuple[int, str, dict[str, str]]:
    insufficient = CHALLENGE + ', error="insufficient_scope"'
    detail = f"the token of {token.name} may only read; changing something needs one that may write"
    return 403, detail, {"WWW-Authenticate": insufficient}


def _holder(request: Request, tokens: TokenFile) -> Token | None:
    """Returns the presented token, or without an Authorization header that of the session."""
    given = request.headers.getlist("authorization")
    if not given:
        session = sessions.presented(request.headers)
        return None if session is None else sessions.holder(session, tokens)
    presented = _bearer(given[0]) if len(given) == 1 else None
    return None if presented is None else tokens.find(presented)


def _is_open(request: Request) -> bool:
    """Returns whether a request needs no token: of a probe, or for the page, its files and the documentation."""
    path = request.scope["path"]
    return path in OPEN or (request.method in READING and (path in {"/", HELP} or path.startswith((PAGE, HELP + "/"))))


def _bearer(header: str) -> bytes | None:
    """Returns the token in an Authorization header, as sent; None for another scheme."""
    scheme, _, token = header.encode("latin-1").partition(b" ")
    return token.strip(b" ") if scheme.lower() == b"bearer" else None


def _only_checks(request: Request) -> bool:
    """Returns whether a POST stores nothing. Compares the query to the letter, as the route reads it."""
    path = request.scope["path"]
    checked = path == LOOK_UP or (path in CHECKED and request.scope["query_string"] == b"validate_only=true")
    return request.method == "POST" and checked


def is_loopback_host(host: str) -> bool:
    """Returns True for localhost and addresses of the loopback interface, with any port."""
    name, colon, port = host.rpartition(":")
    if not colon or host.endswith("]"):
        name, port = host, ""
    if port and not (port.isascii() and port.isdecimal()):
        return False
    if name.startswith("[") and name.endswith("]"):
        return ":" in name[1:-1] and is_this_machine(name[1:-1])
    return is_this_machine(name)

"""The page's sessions: a browser that logged in once is known by a cookie instead of a header.

A session is a signed statement that the server does not store: the name of a token, an end, and a signature with a key derived from the
token. It survives a restart of the server, ends with the token, and cannot be guessed. Scripts cannot read the cookie, and only requests
of the page itself send it; shared/decisions/018-the-page-and-its-session.md lists the alternatives.
"""

import hmac
import time
from hashlib import sha256
from http.cookies import CookieError, SimpleCookie

from starlette.datastructures import Headers

from drivecal.api.responses import ROOT
from drivecal.configuration.tokens import Token, TokenFile

SECONDS = 12 * 3600
"""Duration of a session: a day's work."""
PATH = f"{ROOT}/session"
"""Path at which sessions begin and end."""
_LONGEST = 300


def cookie_name(host: str) -> str:
    """Returns the cookie's name with the port: browsers keep cookies by host, and two servers may share a machine."""
    port = host.rpartition(":")[2]
    return f"drivecal-session-{port}" if port.isascii() and port.isdecimal() else "drivecal-session"


def begin(token: Token) -> str:
    """Returns the cookie's value for a session that begins now."""
    end = int(time.time() + SECONDS)
    return f"{end}-{_signature(token, end)}-{token.name}"


def holder(value: str, tokens: TokenFile) -> Token | None:
    """Returns the token of the session in a cookie's value; None if the session is unknown or over."""
    if len(value) > _LONGEST or value.count("-") < 2:
        return None
    end, signature, name = value.split("-", 2)
    if not (end.isascii() and end.isdecimal()) or int(end) <= time.time():
        return None
    token = tokens.named(name)
    if token is None or not hmac.compare_digest(signature.encode(), _signature(token, int(end)).encode()):
        return None
    return token


def presented(headers: Headers) -> str | None:
    """Returns the value of the session's cookie, None without one."""
    try:
        cookie = SimpleCookie(headers.get("cookie", "")).get(cookie_name(headers.get("host", "")))
    except CookieError:
        return None
    return None if cookie is None else cookie.value


def same_origin(headers: Headers) -> bool:
    """Returns whether the asking page comes from this very host and port; False if the browser does not say."""
    hosts, origins = headers.getlist("host"), headers.getlist("origin")
    return len(hosts) == 1 and origins in ([f"http://{hosts[0]}"], [f"https://{hosts[0]}"])


def _signature(token: Token, end: int) -> str:
    return hmac.new(token.digest, f"drivecal page {end} {token.name}".encode(), sha256).hexdigest()

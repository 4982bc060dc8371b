"""Logging in, for the page: a token is shown once, and then a cookie that no script can read stands for it."""

from fastapi import APIRouter, Request, Response

from drivecal.api.http import sessions
from drivecal.api.http.authorisation import ANYBODY
from drivecal.configuration.pushing import FILE, Pushing
from drivecal.configuration.tokens import Token
from drivecal.contracts.campaign import Answer

router = APIRouter(tags=["page"])


class Session(Answer):
    """The client and its rights; `name` is null without tokens. `may_push`: with its token, which the page asks for again; without tokens
    with a signature by the content of the file `signed_by`."""

    name: str | None
    may_write: bool
    may_push: bool
    signed_by: str | None


@router.get("/session")
def read_session(request: Request) -> Session:
    """The client's token. 401 if it is unknown."""
    return _session(request)


@router.post("/session")
def begin_session(request: Request, response: Response) -> Session:
    """Starts a session for a token. It ends after twelve hours, or when the token is removed from the tokens file."""
    token: Token = request.state.token
    if token is not ANYBODY:
        response.set_cookie(
            sessions.cookie_name(request.headers.get("host", "")),
            sessions.begin(token),
            max_age=sessions.SECONDS,
            httponly=True,
            samesite="strict",
            secure=request.headers.get("origin", "").startswith("https:"),
        )
    return _session(request)


@router.delete("/session", status_code=204)
def end_session(request: Request, response: Response) -> None:
    """Takes the session's cookie away."""
    response.delete_cookie(sessions.cookie_name(request.headers.get("host", "")), httponly=True, samesite="strict")


def _session(request: Request) -> Session:
    token: Token = request.state.token
    pushing: Pushing = request.app.state.pushing
    signed_by = str(pushing.home / FILE) if pushing.secret is not None and pushing.home is not None else None
    return Session(
        name=None if token is ANYBODY else token.name,
        may_write=token.may_write,
        may_push=pushing.allowed and (token.may_push or signed_by is not None),
        signed_by=signed_by,
    )

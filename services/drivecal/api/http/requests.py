"""Id, log line and metrics of every request; the outermost middleware."""

import logging
import re
import time
import uuid
from http import HTTPStatus

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from drivecal.api.http.authorisation import READING
from drivecal.api.http.problems import REQUEST_ID
from drivecal.api.metrics import Meters
from drivecal.api.responses import ROOT
from drivecal.configuration import logs

METHODS = READING | {"POST", "PUT", "PATCH", "DELETE"}
LONGEST_PATH = 200
"""Characters of a path that the log shows."""
_SANE = re.compile(r"[\w.:/+=-]{1,100}", re.ASCII)

log = logging.getLogger("drivecal.api")


class RequestRecords:
    """ASGI middleware. A request keeps a short and plain `X-Request-ID` or gets a new one, which the answer and all its log lines carry.

    Requests that may change something are logged at level info, others at debug, so that polling clients do not flood the log.
    """

    def __init__(self, app: ASGIApp, meters: Meters) -> None:
        self.app = app
        self.meters = meters

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes the request on and records its outcome."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        begin = time.perf_counter()
        given = Headers(scope=scope).get(REQUEST_ID, "")
        request_id = given if _SANE.fullmatch(given) else uuid.uuid4().hex
        scope.setdefault("state", {})["request_id"] = request_id
        logs.begin(request=request_id)
        status = int(HTTPStatus.INTERNAL_SERVER_ERROR)  # where nothing is answered here, an error is answered outside
        streams = False

        async def noting(message: Message) -> None:
            nonlocal status, streams
            if message["type"] == "http.response.start":
                status = message["status"]
                headers = MutableHeaders(scope=message)
                headers[REQUEST_ID] = request_id
                streams = headers.get("content-type", "").startswith("text/event-stream")
            await send(message)

        try:
            await self.app(scope, receive, noting)
        finally:
            self._note(scope, status, None if streams else time.perf_counter() - begin)

    def _note(self, scope: Scope, status: int, seconds: float | None) -> None:
        """Counts and logs a request. `seconds` is None for an event stream, which lasts as long as its client listens."""
        route = _template(scope)
        method = scope["method"] if scope["method"] in METHODS else "other"
        self.meters.requests.labels(route, method, status).inc()
        if seconds is not None:
            self.meters.request_seconds.labels(route, method).observe(seconds)
        level = logging.DEBUG if method in READING else logging.INFO
        if log.isEnabledFor(level):
            path, campaign = scope["path"][:LONGEST_PATH], scope.get("path_params", {}).get("campaign_id")
            known = {"campaign": campaign, "method": method, "path": path, "status": status}
            known["milliseconds"] = None if seconds is None else round(1000 * seconds, 1)
            fields = {name: value for name, value in known.items() if value is not None}
            log.log(level, "%s %s: %d", method, path, status, extra=fields)


def _template(scope: Scope) -> str:
    """Returns the path with its parameters' names, `none` without a route. FastAPI may omit the prefix of an included router."""
    route: str | None = getattr(scope.get("route"), "path", None)
    if route is None:
        return "none"
    return ROOT + route if scope["path"].startswith(ROOT) and not route.startswith(ROOT) else route

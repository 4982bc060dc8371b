"""Health and metrics of the service, outside /api, for supervisors, load balancers and Prometheus."""

from fastapi import APIRouter, Request, Response
from prometheus_client import exposition
from prometheus_client.openmetrics import exposition as openmetrics

from drivecal.api.dependencies import DatabaseDependency
from drivecal.api.http.problems import RETRY_SECONDS
from drivecal.api.live.dispatcher_health import Judgement, judge
from drivecal.api.metrics import Meters
from drivecal.configuration.tokens import TokenFile
from drivecal.contracts.inventory import Readiness
from drivecal.domain.errors import DrivecalError, UnavailableError
from drivecal.plugins import registry
from drivecal.storage import processes
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now

router = APIRouter(tags=["health"])

OPEN_METRICS = "application/openmetrics-text"


@router.get("/healthz")
async def alive() -> dict[str, str]:
    """The process answers. It checks nothing else: a restart cures no fault of another process."""
    return {"status": "alive"}


@router.get("/readyz", responses={503: {"model": Readiness, "description": "Not ready; `problems` says why"}})
def ready(request: Request, response: Response, database: DatabaseDependency) -> Readiness:
    """Campaigns can be stored, and a dispatcher with a worker can run them. A single working worker suffices, even if `problems` lists
    missing workers, workers that refuse a campaign, plug-ins that cannot be used, or a faulty tokens file. `problems` is empty without
    a token if the server requires tokens. Answers within five seconds, whatever is wrong."""
    judgement = _judge(database)
    if not judgement.ready:
        response.status_code = 503
        response.headers["Retry-After"] = str(RETRY_SECONDS)
    shown = [] if request.state.token is None else [*judgement.problems, *map(str, registry.broken())]
    tokens: TokenFile | None = request.app.state.tokens
    if request.state.token is not None and tokens is not None and tokens.fault is not None:
        shown.append(tokens.fault)
    return Readiness(ready=judgement.ready, problems=shown)


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}, OPEN_METRICS: {}}}})
def metrics(request: Request) -> Response:
    """Metrics in Prometheus' text format, or in OpenMetrics on request."""
    meters: Meters = request.app.state.meters
    content, media_type = exposition.generate_latest(meters.registry), exposition.CONTENT_TYPE_PLAIN_0_0_4
    if OPEN_METRICS in request.headers.get("accept", ""):
        content = openmetrics.generate_latest(meters.registry)  # type: ignore[no-untyped-call]  # it has no types
        media_type = openmetrics.CONTENT_TYPE_LATEST
    return Response(content, headers={"Content-Type": media_type, "Vary": "Accept"})


def _judge(database: Database) -> Judgement:
    try:
        database.check()
        judgement = judge(database.query(processes.read, processes.DISPATCHER), now())
    except DrivecalError as error:
        return Judgement(ready=False, problems=(str(error),))
    reason = _locked(database) if judgement.silent else None
    return judgement if reason is None else Judgement(ready=False, problems=(reason, *judgement.problems), silent=True)


def _locked(database: Database) -> str | None:
    """Returns why nothing can be written, for example because another program has SQLite's lock; None if it can."""
    try:
        with database.transaction():
            return None
    except UnavailableError as error:
        return str(error)

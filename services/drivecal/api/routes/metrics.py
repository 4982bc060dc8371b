"""`/metrics`, for Prometheus."""

from fastapi import APIRouter, Request, Response
from prometheus_client import exposition
from prometheus_client.openmetrics import exposition as openmetrics

from drivecal.api.metrics import Meters

router = APIRouter(tags=["health"])

OPEN_METRICS = "application/openmetrics-text"


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}, OPEN_METRICS: {}}}})
def metrics(request: Request) -> Response:
    """Metrics in Prometheus' text format, or in OpenMetrics on request."""
    meters: Meters = request.app.state.meters
    if OPEN_METRICS in request.headers.get("accept", ""):
        content: bytes = openmetrics.generate_latest(meters.registry)  # type: ignore[no-untyped-call]  # it has no types
        return _answer(content, openmetrics.CONTENT_TYPE_LATEST)
    return _answer(exposition.generate_latest(meters.registry), exposition.CONTENT_TYPE_PLAIN_0_0_4)


def _answer(content: bytes, media_type: str) -> Response:
    return Response(content, headers={"Content-Type": media_type, "Vary": "Accept"})

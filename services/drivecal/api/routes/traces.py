"""The time series of one evaluation, for people to look at."""

import gzip
from hashlib import sha256
from typing import Annotated

from fastapi import APIRouter, Header, Request, Response

from drivecal.api.dependencies import DatabaseDependency, LimitsDependency
from drivecal.api.http.authorisation import refuse_reader
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.responses import SECONDS_BETWEEN_POLLS, matches, takes_gzip
from drivecal.api.routes.evaluations import number_of
from drivecal.campaigns.cells.tracing import is_to_be_made, no_trace, request_trace
from drivecal.contracts.evaluation import PendingTrace, SeriesAnswer, TraceAnswer
from drivecal.domain.errors import ConflictError
from drivecal.storage import admission, results, traces

router = APIRouter(prefix="/evaluations", tags=["evaluations"], route_class=StrictRoute)

ANSWERS: dict[int | str, dict[str, object]] = {
    200: {"model": TraceAnswer | SeriesAnswer, "description": "Of a problem bundle, the series that its simulator reported"},
    202: {"model": PendingTrace, "description": "it is being made; ask again after `Retry-After` seconds"},
    304: {"description": "it is what `If-None-Match` names"},
}


@router.get("/{evaluation_id}/trace", response_model=None, responses=ANSWERS)
def read_trace(
    evaluation_id: str,
    request: Request,
    database: DatabaseDependency,
    limits: LimitsDependency,
    if_none_match: Annotated[str | None, Header()] = None,
    accept_encoding: Annotated[str, Header()] = "",
) -> Response:
    """The time series of an evaluation, by its number in a campaign's table or by the id of a single evaluation in one scenario. The first
    request simulates it once more (202), which takes a token that may write; the result is kept for a day. If the simulation fails, the
    answer is 409 with the cause. After a cause that may pass (a crash, a hang, a lack of memory), a request half a minute later tries
    again."""
    with database.read() as connection:
        number = results.by_id(connection, number_of(connection, evaluation_id)).id
        trace = traces.find(connection, number)
    if trace is not None and trace.content is not None:
        return _answer(trace.content, if_none_match, accept_encoding)
    with database.transaction() as connection:
        admission.alone(connection)  # before the evaluation's lock: what removes cells takes both in this order
        if is_to_be_made(connection, traces.find(connection, number, for_update=True)):
            refuse_reader(request)
            admission.admit(connection, limits.queued_campaigns, None)
        made = request_trace(connection, number)
        again = traces.find(connection, number)
        if again is not None and again.content is not None:
            return _answer(again.content, if_none_match, accept_encoding)
        if made.state.ended:
            raise ConflictError(f"there is no trace of evaluation {number}: {no_trace(connection, made)}")
    location = f"/api/v1/evaluations/{evaluation_id}/trace"
    body = PendingTrace(evaluation=number, state=made.state, degraded=made.degraded, links={"self": location})
    headers = {"Location": location, "Retry-After": str(SECONDS_BETWEEN_POLLS)}
    return Response(body.model_dump_json(), 202, headers=headers, media_type="application/json")


def _answer(content: bytes, if_none_match: str | None, accept_encoding: str) -> Response:
    tag = f'"{sha256(content).hexdigest()[:32]}"'
    headers = {"ETag": tag, "Vary": "Accept-Encoding"}
    if matches(if_none_match, tag):
        return Response(status_code=304, headers=headers)
    if takes_gzip(accept_encoding):
        return Response(content, headers=headers | {"Content-Encoding": "gzip"}, media_type="application/json")
    return Response(gzip.decompress(content), headers=headers, media_type="application/json")

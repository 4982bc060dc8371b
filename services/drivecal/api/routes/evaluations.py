"""Single evaluations: one parameter set, driven in one scenario or in all of a catalogue."""

import gzip
from hashlib import sha256
from typing import Annotated, Any

from fastapi import APIRouter, Header, Request, Response
from sqlalchemy import Connection

from drivecal.api import submission
from drivecal.api.dependencies import DatabaseDependency, IntakeDependency, LimitsDependency, computed
from drivecal.api.http.authorisation import refuse_reader
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.responses import SECONDS_BETWEEN_POLLS, evaluation_answer, evaluation_row, matches, takes_gzip
from drivecal.campaigns.cells.tracing import is_to_be_made, no_trace, request_trace
from drivecal.campaigns.resolve.resolved_spec import stored_scale
from drivecal.campaigns.results.explanation import explain
from drivecal.contracts.evaluation import (
    CampaignOfEvaluation,
    EvaluatedCell,
    Evaluation,
    EvaluationDetail,
    Explanation,
    PendingTrace,
    SeriesAnswer,
)
from drivecal.contracts.specification import EvaluationSpecification
from drivecal.domain.errors import ConflictError, NotFoundError
from drivecal.storage import admission, campaigns, evaluations, results, traces
from drivecal.storage.campaigns import StoredCampaign

router = APIRouter(prefix="/evaluations", tags=["evaluations"], route_class=StrictRoute)

MOST_SCENARIOS = 1000


@router.post("", status_code=202)
def evaluate(specification: EvaluationSpecification, response: Response, intake: IntakeDependency) -> Evaluation:
    """Queues the evaluation of one parameter set; `Location` is the URL of its result."""
    stored = submission.evaluate(intake.database, intake.limits, specification, intake.key, intake.owner)
    answer = intake.database.query(_evaluation, stored)
    response.headers["Location"] = answer.links["self"]
    return answer


@router.get("/{evaluation_id}", response_model=None, responses={200: {"model": Evaluation | EvaluationDetail}})
def read(evaluation_id: str, response: Response, database: DatabaseDependency) -> Evaluation | dict[str, Any]:
    """A single evaluation by the id that posting it gave; or, by the number in the first column of a campaign's table, that row with
    its measures, its campaign and, if it failed, the cause."""
    with database.read() as connection:
        if _is_number(evaluation_id):
            return _detail(connection, int(evaluation_id))
        stored = _single(connection, evaluation_id)
        if not stored.state.ended:
            response.headers["Retry-After"] = str(SECONDS_BETWEEN_POLLS)
        return _evaluation(connection, stored)


@router.get("/{evaluation_id}/explain")
@computed
def explain_evaluation(evaluation_id: str, database: DatabaseDependency) -> Explanation:
    """The reason why a cell was answered from the reference table, or was not: by its number in a campaign's table, or by the id of a
    single evaluation in one scenario."""
    with database.read() as connection:
        return explain(connection, number_of(connection, evaluation_id))


def number_of(connection: Connection, evaluation_id: str) -> int:
    """Returns the number of the cell that an id names. Raises NotFoundError, and ConflictError for no cell yet or several."""
    if _is_number(evaluation_id):
        return int(evaluation_id)
    rows, _ = results.page(connection, _single(connection, evaluation_id).sequence, limit=MOST_SCENARIOS)
    if len(rows) != 1:
        listed = ", ".join(f"{row.id} ({row.scenario})" for row in rows)
        raise ConflictError(f"evaluation {evaluation_id} has {len(rows)} cells; ask for one of {listed}" if rows else _NOT_YET)
    return rows[0].id


_NOT_YET = "nothing of it has been asked for yet; try again when it has started"


def _detail(connection: Connection, number: int) -> dict[str, Any]:
    row = results.by_id(connection, number)
    measured = evaluations.measured(connection, {row.id: row.run_id})
    made_by = campaigns.by_sequence(connection, row.campaign_sequence)
    campaign = CampaignOfEvaluation(id=made_by.id, problem=made_by.spec["problem"], scale=stored_scale(made_by.resolution))
    return evaluation_row(row) | {
        "detail": row.detail,
        "metrics": measured.get(row.id),
        "parameters": row.parameters.floats,
        "campaign": campaign.model_dump(mode="json"),
    }


def _is_number(evaluation_id: str) -> bool:
    return evaluation_id.isascii() and evaluation_id.isdecimal() and len(evaluation_id) < 20


def _single(connection: Connection, evaluation_id: str) -> StoredCampaign:
    """Returns a single evaluation. Raises NotFoundError."""
    try:
        stored = campaigns.get(connection, evaluation_id)
    except NotFoundError:
        stored = None
    if stored is None or stored.kind != "evaluation":
        raise NotFoundError("evaluation", evaluation_id)
    return stored


def _evaluation(connection: Connection, stored: StoredCampaign) -> Evaluation:
    rows = list(results.stream(connection, stored.sequence))
    measured = evaluations.measured(connection, {row.id: row.run_id for row in rows})
    seeds = {row.id: [row.seed] if row.has_seed else [] for row in rows}
    return evaluation_answer(stored, [EvaluatedCell.of(row, metrics=measured.get(row.id), seeds=seeds[row.id]) for row in rows])


ANSWERS: dict[int | str, dict[str, object]] = {
    200: {"model": SeriesAnswer, "description": "Its time series"},
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
            admission.admit(connection, limits.settings.queued_campaigns, None)
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

"""Single evaluations: one parameter set, driven in one scenario or in all of a catalogue."""

from typing import Any

from fastapi import APIRouter, Response
from sqlalchemy import Connection

from drivecal.api import submission
from drivecal.api.computed import computed
from drivecal.api.dependencies import DatabaseDependency, IdempotencyKey, LimitsDependency
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.responses import SECONDS_BETWEEN_POLLS, evaluated_cell, evaluation_answer, evaluation_row
from drivecal.campaigns.resolve.resolved_spec import stored_scale
from drivecal.campaigns.results.explanation import explain
from drivecal.contracts.evaluation import CampaignOfEvaluation, Evaluation, EvaluationDetail
from drivecal.contracts.explanation import Explanation
from drivecal.contracts.specification import HIGHWAY, EvaluationSpecification
from drivecal.domain.errors import ConflictError, NotFoundError
from drivecal.storage import campaigns, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.references import runs

router = APIRouter(prefix="/evaluations", tags=["evaluations"], route_class=StrictRoute)

MOST_SCENARIOS = 1000


@router.post("", status_code=202)
def evaluate(
    specification: EvaluationSpecification,
    response: Response,
    database: DatabaseDependency,
    limits: LimitsDependency,
    idempotency_key: IdempotencyKey = None,
) -> Evaluation:
    """Queues the evaluation of one parameter set; `Location` is the URL of its result."""
    stored = submission.evaluate(database, limits, specification, idempotency_key)
    with database.read() as connection:
        answer = _evaluation(connection, stored)
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
    measured = runs.metrics(connection, [] if row.run_id is None else [row.run_id])
    made_by = campaigns.by_sequence(connection, row.campaign_sequence)
    campaign = CampaignOfEvaluation(
        id=made_by.id, problem=made_by.spec.get("problem", HIGHWAY), scale=stored_scale(made_by.resolution)
    )
    return evaluation_row(row) | {
        "detail": row.detail,
        "metrics": None if row.run_id is None else measured[row.run_id],
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
    rows, _ = results.page(connection, stored.sequence, limit=MOST_SCENARIOS)
    measured = runs.metrics(connection, [row.run_id for row in rows if row.run_id is not None])
    return evaluation_answer(stored, [evaluated_cell(row, measured.get(row.run_id or 0)) for row in rows])

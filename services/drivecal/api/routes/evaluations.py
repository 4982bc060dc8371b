"""Single evaluations: one parameter set, driven in one scenario or in all of a catalogue."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Response
from sqlalchemy import Connection

from drivecal.api import submission
from drivecal.api.answers import evaluated_cell, evaluation_answer, evaluation_row
from drivecal.api.bodies import StrictRoute
from drivecal.api.dependencies import DatabaseDependency, IdempotencyKey
from drivecal.contracts.evaluation import Evaluation
from drivecal.contracts.specification import EvaluationSpecification
from drivecal.domain.errors import NotFoundError
from drivecal.storage import campaigns, results, runs
from drivecal.storage.campaigns import StoredCampaign

router = APIRouter(prefix="/evaluations", tags=["evaluations"], route_class=StrictRoute)

MOST_SCENARIOS = 1000
SECONDS_BETWEEN_POLLS = 1


@router.post("", status_code=202)
def evaluate(
    specification: EvaluationSpecification,
    response: Response,
    database: DatabaseDependency,
    idempotency_key: IdempotencyKey = None,
) -> Evaluation:
    """Queues the evaluation of one parameter set; `Location` says where its result will be."""
    stored = submission.evaluate(database, specification, idempotency_key)
    with database.read() as connection:
        answer = _evaluation(connection, stored)
    response.headers["Location"] = answer.links["self"]
    return answer


@router.get("/{evaluation_id}", response_model=None, responses={200: {"model": Evaluation}})
def read(evaluation_id: str, response: Response, database: DatabaseDependency) -> Evaluation | dict[str, Any]:
    """A single evaluation by the id that posting it gave; or, by the number in the first column of a campaign's table, that row with
    its metrics."""
    with database.read() as connection:
        if evaluation_id.isascii() and evaluation_id.isdecimal() and len(evaluation_id) < 20:
            row = results.by_id(connection, int(evaluation_id))
            measured = runs.metrics(connection, [] if row.run_id is None else [row.run_id])
            return evaluation_row(row) | {"metrics": None if row.run_id is None else measured[row.run_id]}
        try:
            stored = campaigns.get(connection, evaluation_id)
        except NotFoundError:
            stored = None
        if stored is None or stored.kind != "evaluation":
            raise NotFoundError("evaluation", evaluation_id)
        if not stored.state.ended:
            response.headers["Retry-After"] = str(SECONDS_BETWEEN_POLLS)
        return _evaluation(connection, stored)


def _evaluation(connection: Connection, stored: StoredCampaign) -> Evaluation:
    rows, _ = results.page(connection, stored.sequence, limit=MOST_SCENARIOS)
    measured = runs.metrics(connection, [row.run_id for row in rows if row.run_id is not None])
    return evaluation_answer(stored, [evaluated_cell(row, measured.get(row.run_id or 0)) for row in rows])

"""Has an evaluation driven once more for its time series: as a single evaluation, through the same queue and the same workers."""

from __future__ import annotations

from typing import Any

from sqlalchemy import Connection

from drivecal.campaigns.problem import catalogue_scenarios, resolve_evaluation
from drivecal.contracts.specification import EvaluationSpecification
from drivecal.contracts.validation import validated
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import ConflictError
from drivecal.domain.setups import Setup
from drivecal.storage import campaigns, results, setups, traces
from drivecal.storage.campaigns import StoredCampaign


def request_trace(connection: Connection, number: int) -> StoredCampaign:
    """Queues the single evaluation that makes an evaluation's trace, unless that is queued or made already.

    Raises NotFoundError, ConflictError where what it was driven with is another version by now: its time series cannot be had again.
    """
    found = traces.find(connection, number, for_update=True)
    if found is not None:
        made = campaigns.by_sequence(connection, found.campaign_sequence)
        if made.state is not CampaignState.CANCELLED or found.content is not None:
            return made
        traces.forget(connection, number)
    specification = _specification(connection, number)
    made = campaigns.insert(
        connection, name=f"trace of evaluation {number}", spec=specification.model_dump(mode="json"), kind="evaluation"
    )
    traces.ask(connection, number, made.sequence)
    return made


def _specification(connection: Connection, number: int) -> EvaluationSpecification:
    row = results.by_id(connection, number)
    spec = campaigns.by_sequence(connection, row.campaign_sequence).spec
    stored = setups.by_id(connection, row.setup_id)
    driven = Setup.from_document(stored.document)
    catalogue, _ = catalogue_scenarios(spec["catalogue"])[row.scenario]
    document: dict[str, Any] = {
        "parameters": row.parameters,
        "scenario": row.scenario,
        "catalogue": catalogue,
        "driving_function": driven.driving_function,
        "vehicle": {"model": driven.vehicle, "parameters": dict(driven.vehicle_parameters)},
        "evaluator": spec["evaluator"],
    }
    specification = validated(EvaluationSpecification, document)
    today = resolve_evaluation(specification).bench.setups[row.scenario]
    if today.fingerprint != stored.fingerprint:
        changed = [name for name, value in today.document.items() if stored.document.get(name) != value]
        raise ConflictError(
            f"evaluation {number} was driven with another {', '.join(changed) or 'version'} than is installed now, so its time series"
            " cannot be had again; evaluate its parameters anew"
        )
    return specification


def no_trace(connection: Connection, made: StoredCampaign) -> str:
    """Why a single evaluation that has ended left no trace."""
    rows, _ = results.page(connection, made.sequence, limit=1)
    cause = made.error or (rows[0].detail or rows[0].failure if rows else None) or made.state.value
    return f"it could not be driven again: {cause}"

"""Repeats an evaluation for its time series, as a single evaluation through the same queue and workers."""

from datetime import timedelta
from typing import Any

from sqlalchemy import Connection

from drivecal.campaigns.resolve.problem import resolve_evaluation
from drivecal.campaigns.resolve.workbench import bundles_of, with_tools
from drivecal.contracts.input_errors import validated
from drivecal.contracts.specification import EvaluationSpecification
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import ConflictError
from drivecal.domain.evaluations import Breakdown, Outcome
from drivecal.domain.setups import base_of
from drivecal.storage import campaigns, results, traces
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.types import now
from drivecal.storage.references import setups
from drivecal.storage.results import StoredEvaluation
from drivecal.storage.traces import StoredTrace

PASSING = (Breakdown.CRASH, Breakdown.HANG, Breakdown.MEMORY)
"""Breakdowns caused by the machine, not the cell. An exception on two workers is lasting."""
AGAIN_AFTER = timedelta(seconds=30)
"""Delay before a trace that failed for a passing reason is tried again; until then, requests return the reason."""


def is_to_be_made(connection: Connection, trace: StoredTrace | None) -> bool:
    """Returns whether a request starts a simulation: no trace was requested before, or the failed request may be repeated."""
    if trace is None:
        return True
    if trace.content is not None:
        return False
    made = campaigns.by_sequence(connection, trace.campaign_sequence)
    if made.state is CampaignState.CANCELLED:
        return True
    return _may_pass(made, _cell(connection, made)) and made.ended_at is not None and now() >= made.ended_at + AGAIN_AFTER


def request_trace(connection: Connection, number: int) -> StoredCampaign:
    """Queues the single evaluation for a trace, unless it is queued, finished, or failed for a lasting reason.

    Raises NotFoundError, and ConflictError if a version has changed since: the time series cannot be reproduced.
    """
    trace = traces.find(connection, number, for_update=True)
    if trace is not None:
        if not is_to_be_made(connection, trace):
            return campaigns.by_sequence(connection, trace.campaign_sequence)
        traces.forget(connection, number)
    specification, resolution = _specification(connection, number)
    made = campaigns.insert(
        connection, name=f"trace of evaluation {number}", spec=specification.model_dump(mode="json"), kind="evaluation"
    )
    if "tools" in resolution:  # workers with other tools would give another time series
        campaigns.set_resolution(connection, made.sequence, resolution)
    traces.ask(connection, number, made.sequence)
    return made


def _specification(connection: Connection, number: int) -> tuple[EvaluationSpecification, dict[str, Any]]:
    """Returns the specification that repeats an evaluation, and its resolution."""
    row = results.by_id(connection, number)
    spec = campaigns.by_sequence(connection, row.campaign_sequence).spec
    stored = setups.by_id(connection, row.setup_id)
    document: dict[str, Any] = {"parameters": row.parameters.floats, "scenario": base_of(row.scenario)}
    document |= {name: spec[name] for name in ("problem", "evaluator", "driving_function")}
    document["vehicle"] = spec["vehicle"] | {"parameters": dict(stored.varied)}
    if row.has_seed:
        document["seeds"] = [row.seed]
    if "catalogue" in stored.document["data"]:
        document["catalogue"] = stored.document["data"]["catalogue"]
    specification = validated(EvaluationSpecification, document)
    tools: Any = stored.document.get("tools")
    problem = resolve_evaluation(specification, with_tools(bundles_of(connection), tools))
    today = problem.bench.setups[base_of(row.scenario)]
    if today.fingerprint != stored.fingerprint:
        changed = [name for name, value in today.document.items() if stored.document.get(name) != value]
        raise ConflictError(
            f"evaluation {number} was simulated with another {', '.join(changed) or 'version'} than is installed now, so its time series"
            " cannot be repeated; evaluate its parameters again"
        )
    return specification, problem.resolution() | ({} if tools is None else {"tools": tools})


def no_trace(connection: Connection, made: StoredCampaign) -> str:
    """Returns the reason why a finished single evaluation left no trace, and whether to request it again."""
    cell = _cell(connection, made)
    detail = cell.detail if cell and cell.outcome is Outcome.FAILED else None
    cause = made.error or detail or (cell and cell.failure) or made.state.value
    text = f"it could not be driven again: {cause}"
    if _may_pass(made, cell):
        return f"{text}. The cause may have passed: ask again after {AGAIN_AFTER.total_seconds():.0f} s"
    return text


def _cell(connection: Connection, made: StoredCampaign) -> StoredEvaluation | None:
    rows, _ = results.page(connection, made.sequence, limit=1)
    return rows[0] if rows else None


def _may_pass(made: StoredCampaign, cell: StoredEvaluation | None) -> bool:
    """Returns whether a failed trace may succeed later: the evaluation failed as a whole, or broke down without an exception."""
    return made.state is CampaignState.FAILED or (cell is not None and cell.failure in PASSING)

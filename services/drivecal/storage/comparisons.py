"""The runs of a comparison: campaigns that belong to another one, and end or pause with it."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Row, func, select, update

from drivecal.contracts.campaign import Baseline, Best, ErrorRate
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import ConflictError
from drivecal.domain.events import EventKind
from drivecal.storage import events, leases
from drivecal.storage.campaign_stages import CountsByStage, by_stage
from drivecal.storage.engine.records import record
from drivecal.storage.engine.tables import campaigns
from drivecal.storage.engine.types import now

BATCH = 100
"""Runs that a sum over all of them holds in memory at a time."""
_OPEN = tuple(state for state in CampaignState if not state.ended)
_FOLLOWS: dict[CampaignState, tuple[Collection[CampaignState], CampaignState, EventKind]] = {
    CampaignState.PAUSED: ((CampaignState.RUNNING,), CampaignState.PAUSED, EventKind.PAUSED),
    CampaignState.RUNNING: ((CampaignState.PAUSED,), CampaignState.RUNNING, EventKind.RESUMED),
    CampaignState.CANCELLED: (_OPEN, CampaignState.CANCELLED, EventKind.CANCELLED),
    CampaignState.FAILED: (_OPEN, CampaignState.CANCELLED, EventKind.CANCELLED),
}
"""By the state of a comparison: the states of the runs that change, their new state, and its event."""


def follow(connection: Connection, sequence: int, state: CampaignState) -> None:
    """Changes the runs of a comparison to its `state`; does nothing for other campaigns."""
    if state not in _FOLLOWS:
        return
    before, after, follows = _FOLLOWS[state]
    values = {"state": after, "revision": campaigns.c.revision + 1, "degraded": None}
    values |= {"ended_at": now()} if after.ended else {}
    mine = campaigns.c.parent_sequence == sequence
    statement = update(campaigns).where(mine, campaigns.c.state.in_(list(before))).values(values)
    for run in sorted(connection.execute(statement.returning(campaigns.c.sequence)).scalars()):
        events.add(connection, run, follows, {"state": after})
    if after.ended:  # what of a run waited for workers when it failed was leased all the same
        for run in connection.scalars(
            select(campaigns.c.sequence).where(mine, campaigns.c.state != CampaignState.SUCCEEDED)
        ).all():
            leases.forget(connection, run)


@dataclass(frozen=True, slots=True)
class RunTally:
    """Summary of a run in its comparison."""

    name: str
    begun: bool
    stages: CountsByStage
    error_rate: Mapping[str, ErrorRate]
    best: Best | None
    baseline: Baseline | None
    simulating_seconds: float
    notes: Sequence[str]


def tallies(connection: Connection, sequence: int) -> Iterator[RunTally]:
    """Yields summaries of a comparison's runs, in order. Holds at most BATCH of them, and no specifications."""
    run = campaigns.c
    columns = (run.name, run.started_at, by_stage(), run.error_rate, run.best, run.baseline)
    query = select(*columns, run.simulating_seconds, run.notes).where(run.parent_sequence == sequence).order_by(run.sequence)
    for row in connection.execute(query.execution_options(yield_per=BATCH)):
        yield record(RunTally, row, begun=row.started_at is not None, **findings(row))


def findings(row: Row[Any]) -> dict[str, Any]:
    """Returns what a campaign found so far, read from its columns `error_rate`, `best` and `baseline`."""
    return {
        "error_rate": {scenario: ErrorRate(**rate) for scenario, rate in row.error_rate.items()},
        "best": None if row.best is None else Best(**row.best),
        "baseline": None if row.baseline is None else Baseline(**row.baseline),
    }


def open_runs(connection: Connection, sequence: int) -> list[int]:
    """The numbers of the runs that have not ended, in their order."""
    query = select(campaigns.c.sequence).where(campaigns.c.parent_sequence == sequence, campaigns.c.state.in_(_OPEN))
    return list(connection.scalars(query.order_by(campaigns.c.sequence)))


def names_of(connection: Connection, sequence: int) -> list[str]:
    """Returns the names of the runs, in their order."""
    query = select(campaigns.c.name).where(campaigns.c.parent_sequence == sequence).order_by(campaigns.c.sequence)
    return list(connection.scalars(query))


def ended_of(connection: Connection, sequence: int) -> tuple[int, int]:
    """Returns the numbers of ended runs and of all runs."""
    mine = select(func.count()).where(campaigns.c.parent_sequence == sequence)
    ended = mine.where(campaigns.c.state.not_in(_OPEN))
    return connection.scalar(ended) or 0, connection.scalar(mine) or 0


def failed_runs(connection: Connection, sequence: int, most: int) -> tuple[int, list[tuple[str, str | None]]]:
    """Returns the number of unsuccessful runs, and the first with its reason."""
    run = campaigns.c
    failed = (run.parent_sequence == sequence) & (run.state != CampaignState.SUCCEEDED)
    query = select(run.name, run.error).where(failed).order_by(run.sequence).limit(most)
    listed = [(name, error) for name, error in connection.execute(query)]
    return connection.scalar(select(func.count()).where(failed)) or 0, listed


def refuse_run(connection: Connection, campaign_id: str, parent_sequence: int | None, action: str) -> None:
    """Raises ConflictError if a campaign belongs to a comparison."""
    comparison = comparison_of(connection, parent_sequence)
    if comparison is not None:
        raise ConflictError(f"campaign {campaign_id} is a run of the comparison {comparison}: {action} that")


def comparison_of(connection: Connection, parent_sequence: int | None) -> str | None:
    """The id of a comparison by its number; None for a campaign outside comparisons."""
    if parent_sequence is None:
        return None
    return connection.scalar(select(campaigns.c.id).where(campaigns.c.sequence == parent_sequence))

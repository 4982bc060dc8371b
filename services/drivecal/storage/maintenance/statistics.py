"""Statistics of the whole database. Sums are over campaigns and their counts by stage, never over cells."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from sqlalchemy import JSON, Connection, case, func, select, type_coerce

from drivecal.domain.campaigns import CampaignState
from drivecal.domain.evaluations import Outcome
from drivecal.storage import processes
from drivecal.storage.campaigns import waits
from drivecal.storage.engine.tables import campaign_stages, campaigns
from drivecal.storage.engine.tables import leases as leases_table
from drivecal.storage.outside.sets import AWAITED
from drivecal.storage.processes import StoredProcess
from drivecal.storage.references import runs


@dataclass(frozen=True, slots=True)
class Statistics:
    """Statistics of the whole database at one moment. The stage of single evaluations is `evaluation`."""

    campaigns: Counter[tuple[str, str]]
    """Campaigns by kind and state."""
    cells: Counter[tuple[str, str]]
    """Answered cells by stage and outcome."""
    pending: Counter[str]
    """Waiting cells of open campaigns by stage."""
    simulating_seconds: float
    leases: int
    """Cells at workers."""
    largest_run: int
    """The number of the newest run in the reference table: how many there are, or, on PostgreSQL, a little more."""
    dispatcher: StoredProcess | None
    waiting: Mapping[str, int]
    """Campaigns that wait by what they wait for: a place, resources or workers for their cells, or sets of another program."""


def read(connection: Connection) -> Statistics:
    """Returns the statistics at this moment."""
    dispatcher = processes.read(connection, processes.DISPATCHER)
    out = 0
    if dispatcher is not None:  # cells at workers, and cells that broke down: never many
        current = (leases_table.c.term == dispatcher.term) & leases_table.c.at_worker
        out = connection.scalar(select(func.count()).select_from(leases_table).where(current)) or 0
    idle = {CampaignState.QUEUED, CampaignState.PAUSED}
    waits_of = ("sets" if why == AWAITED else "place" if state in idle else "cells" for *_, state, why in waits(connection))
    table, by_state = campaigns.c, Counter[tuple[str, str]]()
    cells, pending, seconds = Counter[tuple[str, str]](), Counter[str](), 0.0
    here = func.count(case((table.deleted_at.is_(None), 1)))
    query = select(table.kind, table.state, here, func.sum(table.simulating_seconds)).group_by(table.kind, table.state)
    for kind, state, count, simulated in connection.execute(query):
        by_state[kind, state] = count
        seconds += simulated
    counts = type_coerce(campaign_stages.c.cells, JSON)
    by_outcome = [func.sum(counts[outcome].as_integer()) for outcome in Outcome]
    waits_for = func.sum(case((table.ended_at.is_(None), counts["pending"].as_integer()), else_=0))
    by_stage = select(table.kind, campaign_stages.c.stage, waits_for, *by_outcome).join_from(campaign_stages, campaigns)
    for kind, stage, without_answer, *sums in connection.execute(by_stage.group_by(table.kind, campaign_stages.c.stage)):
        name = stage if kind == "calibration" else kind
        pending[name] = without_answer
        cells.update({(name, outcome): count for outcome, count in zip(Outcome, sums, strict=True)})
    return Statistics(by_state, cells, pending, seconds, out, runs.largest_id(connection), dispatcher, Counter(waits_of))

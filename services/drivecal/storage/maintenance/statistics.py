"""Cheap statistics of the whole database: read every few seconds, never a full table.

What has ended never changes, so it is added up once and carried along in a `Tally`; from one look to the next only campaigns that are
open, or new, are read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import timedelta
from typing import Any, NamedTuple

from sqlalchemy import Connection, func, select

from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.evaluations import Outcome
from drivecal.storage import leases, processes
from drivecal.storage.campaigns import by_stage, waits
from drivecal.storage.engine.bulk import rows_among
from drivecal.storage.engine.tables import campaigns
from drivecal.storage.engine.tables import leases as leases_table
from drivecal.storage.engine.types import now
from drivecal.storage.outside.sets import AWAITED
from drivecal.storage.processes import StoredProcess
from drivecal.storage.references import runs

ROWS_AT_A_TIME = 2000
SETTLED_AFTER = timedelta(minutes=1)
"""Campaigns are numbered before they are committed, so one may become visible after a later one: within this time, amply."""


class CampaignKey(NamedTuple):
    """Group of campaigns."""

    kind: str
    state: str


class CellKey(NamedTuple):
    """Group of cells: `stage` is `evaluation` for single evaluations."""

    stage: str
    outcome: str


@dataclass(frozen=True, slots=True)
class Sums:
    """Sums over campaigns: their number, cells by outcome, waiting cells, and seconds of their simulations."""

    campaigns: Counter[CampaignKey] = field(default_factory=Counter)
    cells: Counter[CellKey] = field(default_factory=Counter)
    pending: Counter[str] = field(default_factory=Counter)
    simulating_seconds: float = 0.0

    def plus(self, rows: Iterable[Any]) -> Sums:
        """These and some campaigns more."""
        sums = Sums(self.campaigns.copy(), self.cells.copy(), self.pending.copy())
        seconds = self.simulating_seconds
        for row in rows:
            sums.campaigns[CampaignKey(row.kind, row.state)] += 1
            seconds += row.simulating_seconds
            for stage, counts in _counts(row):
                for outcome in Outcome:
                    sums.cells[CellKey(stage, outcome)] += counts.get(outcome, 0)
                if row.ended_at is None:
                    sums.pending[stage] += counts.get("pending", 0)
        return Sums(sums.campaigns, sums.cells, sums.pending, seconds)


@dataclass(frozen=True, slots=True)
class Tally:
    """Remembered sums over ended campaigns up to number `settled`, and the `open` campaigns up to there."""

    settled: int = 0
    open: tuple[int, ...] = ()
    ended: Sums = field(default_factory=Sums)


@dataclass(frozen=True, slots=True)
class Statistics:
    """Statistics of the whole database at one moment."""

    sums: Sums
    leases: int
    """Cells at workers."""
    largest_run: int
    """The number of the newest run in the reference table: how many there are, or, on PostgreSQL, a little more."""
    dispatcher: StoredProcess | None
    waiting: Mapping[str, int] = field(default_factory=dict)
    """Campaigns that wait by what they wait for: a place, resources or workers for their cells, or sets of another program."""


def read(connection: Connection, tally: Tally) -> tuple[Statistics, Tally]:
    """The statistics, and the tally to ask with the next time."""
    sums, following = _advance(connection, tally)
    dispatcher = processes.read(connection, processes.DISPATCHER)
    out = 0
    if dispatcher is not None:  # cells at workers, and cells that broke down: never many
        # whatever the time: a slow cell outlasts its lease, which ends when the cell comes back
        current = (leases_table.c.term == dispatcher.term) & (leases_table.c.expires_at != leases.OVER)
        out = connection.scalar(select(func.count()).select_from(leases_table).where(current)) or 0
    waiting = Counter(_awaited(state, reason) for *_, state, reason in waits(connection))
    return Statistics(sums, out, runs.largest_id(connection), dispatcher, waiting), following


def _awaited(state: CampaignState, reason: str) -> str:
    if reason == AWAITED:
        return "sets"
    return "place" if state in {CampaignState.QUEUED, CampaignState.PAUSED} else "cells"


def _advance(connection: Connection, tally: Tally) -> tuple[Sums, Tally]:
    looked_at = list(rows_among(connection, _QUERY, campaigns.c.sequence, tally.open))
    ended = tally.ended.plus(row for row in looked_at if row.ended_at is not None)
    still_open = [row for row in looked_at if row.ended_at is None]
    settled, last = tally.settled, tally.settled
    recent: list[Any] = []
    horizon = now() - SETTLED_AFTER
    while True:
        following = _QUERY.where(campaigns.c.sequence > last).order_by(campaigns.c.sequence).limit(ROWS_AT_A_TIME)
        page = connection.execute(following).all()
        old = 0
        if not recent:
            old = next((index for index, row in enumerate(page) if row.created_at > horizon), len(page))
        ended = ended.plus(row for row in page[:old] if row.ended_at is not None)
        still_open += [row for row in page[:old] if row.ended_at is None]
        recent += page[old:]
        settled = page[old - 1].sequence if old else settled
        if len(page) < ROWS_AT_A_TIME:
            break
        last = page[-1].sequence
    return ended.plus([*still_open, *recent]), Tally(settled, tuple(row.sequence for row in still_open), ended)


def _counts(row: Any) -> Iterable[tuple[str, Mapping[str, int]]]:
    """The counts of a campaign's cells by stage."""
    if row.kind != "calibration":
        return [(row.kind, row.stages.get(StageName.CALIBRATION, {}))]
    return [(stage, row.stages.get(stage, {})) for stage in StageName]


_QUERY = select(
    campaigns.c.sequence,
    campaigns.c.kind,
    campaigns.c.state,
    by_stage(),
    campaigns.c.simulating_seconds,
    campaigns.c.created_at,
    campaigns.c.ended_at,
)

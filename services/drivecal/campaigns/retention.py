"""Prunes old campaigns: their best sets stay, with all that a cell that stays refers to; other cells and runs go.

A plan is made in one snapshot and carried out in slices, so that a server beside it does not wait. A pruning that was killed left a whole
database, and the next one goes on.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from typing import Any, TypeVar

from sqlalchemy import Connection

from drivecal.analysis.goals import valued_by
from drivecal.analysis.solutions import Ranking
from drivecal.bundles.installed import installed
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import ConflictError
from drivecal.storage import bundles, campaigns, results
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.retention import removal
from drivecal.storage.retention.marking import (
    Doomed,
    Prunable,
    Selection,
    bytes_of,
    fingerprints_of,
    mark,
    open_campaigns,
    select_campaigns,
    user_since,
)

SLICE = 1_000
"""Cells that go in a transaction, for which other writers wait."""
STARTING = 60
"""Seconds for which a campaign may be starting before a pruning gives way to it."""
CAMPAIGNS = 20
"""Campaigns that are marked, or removed, in a transaction."""
Item = TypeVar("Item")
Told = Callable[[str, int, int], None]
"""Receives the progress: what goes, the number that is gone, and the number of all."""


@dataclass(frozen=True, slots=True)
class RetentionPlan:
    """A planned pruning: `doomed` cells go from the campaigns in `selection`, whose `best` sets stay, by campaign. `bytes`: about what that
    frees. `fingerprints`: of the setups whose runs go."""

    selection: Selection
    doomed: Doomed
    fingerprints: frozenset[str]
    best: Mapping[int, Sequence[int]]
    bytes: int
    open: tuple[Sequence[int], int]


def plan(database: Database, before: datetime, keep_best: int, problem: str | None = None) -> RetentionPlan:
    """Plans the pruning of the campaigns that ended `before` a moment, of one problem or of all. Only reads.

    The `keep_best` best sets of each stay, under its own weights or on its front. Raises NotFoundError for an unknown problem.
    """
    with database.read() as connection:
        selection = select_campaigns(connection, before, None if problem is None else _pushes(connection, problem))
        best = {campaign.sequence: _best(connection, campaign, keep_best) for campaign in selection.prunable}
        doomed = mark(connection, list(best), best)
        freed = bytes_of(connection, doomed)
        fingerprints = fingerprints_of(connection, doomed.setups)
        return RetentionPlan(selection, doomed, fingerprints, best, freed, open_campaigns(connection))


def carry_out(database: Database, planned: RetentionPlan, progress: Told) -> None:
    """Removes what was planned. Raises ConflictError if a campaign came meanwhile that names a prunable one, or started and may use what
    goes; the rest stays then."""
    moment = now()
    touched = [campaign for campaign in planned.selection.prunable if campaign.sequence in planned.doomed.by_campaign]
    for some in _slices(touched, CAMPAIGNS):
        with _guarded(database, planned) as connection:
            for campaign in some:
                sets = planned.best[campaign.sequence]
                note = f"pruned on {moment:%Y-%m-%d}: its {len(sets):,} best sets are left, and cells that other campaigns refer to"
                pruned: dict[str, Any] = {"at": moment.isoformat(), "sets": list(sets)}
                removal.begin(connection, campaign.sequence, pruned, note)
    with _guarded(database, planned) as connection:
        retired = removal.retire_indexes(connection, planned.doomed.setups)
    for index in retired:
        while _remove_keys(database, index):
            pass
    gone = 0
    for level in planned.doomed.levels:
        for cells in _slices(level.tolist(), SLICE):
            made = [planned.doomed.run[cell] for cell in cells if cell in planned.doomed.run]
            with _guarded(database, planned) as connection:
                removal.remove_cells(connection, cells, made)
            gone += len(cells)
            progress("cells", gone, planned.doomed.cells)
    whole = [campaign.sequence for campaign in planned.selection.prunable if campaign.whole]
    for numbers in _slices(whole, CAMPAIGNS):
        with _guarded(database, planned) as connection:
            for number in numbers:
                removal.remove_campaign(connection, number)


def _remove_keys(database: Database, index: int) -> bool:
    with database.transaction() as connection:
        return removal.remove_keys(connection, index)


@contextmanager
def _guarded(database: Database, planned: RetentionPlan) -> Iterator[Connection]:
    """Yields a transaction beside which no campaign starts. Raises ConflictError if one may use what goes; waits for the setups of one
    that is just starting."""
    prunable = {campaign.id for campaign in planned.selection.prunable}
    for left in reversed(range(STARTING)):
        with database.transaction() as connection:
            removal.alone(connection)
            user = user_since(connection, *planned.open, planned.fingerprints, prunable)
            if user is None:
                yield connection
                return
            if user.known or not left:
                raise ConflictError(f"campaign {user.id} may use what goes; run the command again when it has ended")
        time.sleep(1.0)


def _best(connection: Connection, campaign: Prunable, count: int) -> Sequence[int]:
    """Returns the best parameter sets of a campaign: the first of its front or ranking, or of those that an earlier pruning kept."""
    if campaign.sets is not None:
        return campaign.sets[:count]
    if campaign.kind != "calibration" or count == 0:
        return ()
    stored = campaigns.by_sequence(connection, campaign.sequence)
    if stored.resolution is None:
        return ()
    resolved = resolved_spec(stored)
    goals = resolved.goals
    standing = Ranking(resolved.weights, resolved.scale.sign, goals, resolved.scale.span)
    stage, evaluator = StageName.CALIBRATION, resolved.evaluator
    standing.add(results.answers(connection, campaign.sequence, stage, corrected_by=evaluator, valued=valued_by(goals)))
    front = [member.solution for member in standing.front()] if goals is not None and goals.is_vector else []
    ranked = [solution.parameter_set for solution in (*front, *standing.ranking())]
    return list(dict.fromkeys(ranked))[:count]


def _pushes(connection: Connection, problem: str) -> Collection[str]:
    """Returns the names under which campaigns name a problem: its name, and the digests of all that was pushed under it.

    Raises NotFoundError."""
    own = installed(problem)
    pushed, cursor = {problem, problem if own is None else own.digest}, None
    if own is None:
        bundles.named(connection, problem)
    while True:
        page, cursor = bundles.listing(connection, name=problem, limit=1_000, cursor=cursor)
        pushed |= {heading.digest for heading in page}
        if cursor is None:
            return pushed


def _slices(items: Sequence[Item], size: int) -> Iterator[Sequence[Item]]:
    for start in range(0, len(items), size):
        yield items[start : start + size]

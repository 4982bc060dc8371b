"""Campaigns that may be pruned, and what stays of them: their best sets, and everything that a cell that stays refers to.

A campaign may be pruned if it ended before a moment and no campaign that stays names it. Marking reads all cells and runs once and keeps
some 100 bytes of each in memory, so that no index is needed for a query that comes once in months.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt
from sqlalchemy import Column, ColumnElement, Connection, Select, Text, case, cast, func, or_, select, text

from drivecal.domain.campaigns import CampaignState
from drivecal.domain.evaluations import COPIED
from drivecal.storage.engine.bulk import rows_among
from drivecal.storage.engine.tables import (
    campaigns,
    evaluations,
    influence_maps,
    parameter_sets,
    ratings,
    reference_keys,
    runs,
    setups,
)

_ID = re.compile(r"[0-9a-f]{32}")
_ENDED = tuple(state for state in CampaignState if state.ended)


@dataclass(frozen=True, slots=True)
class Prunable:
    """A campaign that may be pruned. `sets`: the parameter sets that an earlier pruning kept, best first; None if there was none.

    `whole`: whether its row goes with its last cell, as that of a single evaluation or a deleted campaign does.
    """

    sequence: int
    id: str
    name: str
    kind: str
    ended_at: datetime
    sets: tuple[int, ...] | None
    whole: bool


@dataclass(frozen=True, slots=True)
class Spared:
    """A campaign that is old enough and stays; `reason`: why."""

    id: str
    reason: str


@dataclass(frozen=True, slots=True)
class Selection:
    """Campaigns to prune, oldest first, and old ones that stay whole."""

    prunable: Sequence[Prunable]
    spared: Sequence[Spared]


@dataclass(frozen=True, slots=True)
class _Campaign:
    sequence: int
    id: str
    name: str
    kind: str
    state: CampaignState
    started: bool
    ended_at: datetime | None
    setups: frozenset[str]
    known: bool
    """True if its setups are known."""
    names: frozenset[str]
    """Ids of campaigns that it reruns or examines, and of the maker of its influence map."""
    problem: str | None
    pruned: Mapping[str, Any] | None
    deleted: bool


def select_campaigns(connection: Connection, before: datetime, problems: Collection[str] | None) -> Selection:
    """Returns the campaigns that ended `before` a moment; with `problems` only campaigns of these names or digests.

    A campaign stays whole while a campaign that stays reruns it, examines its sets or uses its influence map. So does one whose setups a
    started campaign uses: that may be answered by its runs at any moment.
    """
    rows = {row.sequence: row for row in _campaigns(connection)}
    by_id = {row.id: row.sequence for row in rows.values()}
    old = {
        row.sequence
        for row in rows.values()
        if row.ended_at is not None and row.ended_at < before and (problems is None or row.problem in problems)
    }
    reasons: dict[int, str] = {}
    for user in (row for row in rows.values() if row.started and row.state not in _ENDED):
        for row in (rows[number] for number in old):
            if not user.known or row.setups & user.setups or not row.known:
                reasons.setdefault(row.sequence, f"campaign {user.id} is {user.state} and may use its results")
    _spread(rows, by_id, old, reasons)
    listed = sorted((rows[number] for number in old), key=lambda row: row.sequence)
    return Selection(
        [_prunable(row) for row in listed if row.sequence not in reasons],
        [Spared(row.id, reasons[row.sequence]) for row in listed if row.sequence in reasons],
    )


def _spread(rows: Mapping[int, _Campaign], by_id: Mapping[str, int], old: Collection[int], reasons: dict[int, str]) -> None:
    """Adds the reasons of campaigns that stay because others stay, until nothing changes."""
    staying = [number for number in rows if number not in old or number in reasons]
    while staying:
        row = rows[staying.pop()]
        named = [(by_id[name], f"campaign {row.id} uses it and stays") for name in row.names if name in by_id]
        for number, reason in named:
            if number in old and number not in reasons:
                reasons[number] = reason
                staying.append(number)


def _prunable(row: _Campaign) -> Prunable:
    if row.ended_at is None:
        raise AssertionError(f"campaign {row.id} has not ended")
    kept = None if row.pruned is None else tuple(row.pruned["sets"])
    whole = row.deleted or row.kind == "evaluation"
    return Prunable(row.sequence, row.id, row.name, row.kind, row.ended_at, () if row.deleted else kept, whole)


def _campaigns(connection: Connection, *conditions: ColumnElement[bool]) -> Iterable[_Campaign]:
    table = campaigns.c
    columns = (
        *(table.sequence, table.id, table.name, table.kind, table.state, table.started_at, table.ended_at),
        *(table.rerun_of, table.pruned, table.deleted_at, table.resolution),
        *(cast(table.spec, Text).label("spec"), influence_maps.c.source.label("map_maker")),
    )
    with_maps = campaigns.outerjoin(influence_maps, influence_maps.c.id == table.influence_map_id)
    query = select(*columns).select_from(with_maps).where(*conditions).order_by(table.sequence)
    for row in connection.execute(query.execution_options(yield_per=100)):
        named = {name for name in (row.rerun_of, row.map_maker) if name}
        fingerprints = _setups(row.resolution)
        yield _Campaign(
            sequence=row.sequence,
            id=row.id,
            name=row.name,
            kind=row.kind,
            state=CampaignState(row.state),
            started=row.started_at is not None,
            ended_at=row.ended_at,
            setups=fingerprints,
            known=row.started_at is None or row.resolution is not None or row.state in _ENDED,
            names=frozenset(named | set(_ID.findall(row.spec)) - {row.id}),
            problem=json.loads(row.spec).get("problem"),
            pruned=row.pruned,
            deleted=row.deleted_at is not None,
        )


def _setups(resolution: Mapping[str, Any] | None) -> frozenset[str]:
    """Returns the fingerprints of a resolution's setups; the vehicles of a study follow from them."""
    return frozenset((resolution or {}).get("setups", {}).values())


@dataclass(frozen=True, slots=True)
class User:
    """A campaign that may use what a pruning would remove; `known`: False if it has started and its setups follow in a moment."""

    id: str
    known: bool


def user_since(
    connection: Connection, open_before: Collection[int], newest: int, fingerprints: Collection[str], prunable: Collection[str]
) -> User | None:
    """Returns a campaign that may use runs of these setups, or that came after the campaign numbered `newest` and names one of the
    `prunable` ids; None without one. The caller holds `removal.alone`."""
    table = campaigns.c
    watched = or_(table.sequence.in_(list(open_before)), table.sequence > newest)
    for row in _campaigns(connection, watched):
        if row.sequence > newest and row.names & set(prunable):
            return User(row.id, known=True)
        if row.started and (not row.known or row.setups & set(fingerprints)):
            return User(row.id, row.known)
    return None


def open_campaigns(connection: Connection) -> tuple[list[int], int]:
    """Returns the numbers of campaigns that have not ended, and that of the newest campaign."""
    listed = connection.scalars(select(campaigns.c.sequence).where(campaigns.c.ended_at.is_(None)))
    newest = connection.scalar(select(campaigns.c.sequence).order_by(campaigns.c.sequence.desc()).limit(1))
    return list(listed), newest or 0


def fingerprints_of(connection: Connection, setup_ids: Collection[int]) -> frozenset[str]:
    """Returns the fingerprints of setups by their ids."""
    query = select(setups.c.fingerprint)
    return frozenset(row.fingerprint for row in rows_among(connection, query, setups.c.id, sorted(setup_ids)))


Integers = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]
CHUNK = 5_000
"""Rows that are read at a time."""


@dataclass(frozen=True, slots=True)
class Doomed:
    """Cells that go, in `levels`: those of a level may go in any order, after those of the levels before. `run` by cell: the run that it
    made and that goes with it; `setups`: of these runs, by id; `by_campaign`: cells that go, by number."""

    levels: tuple[Integers, ...]
    run: Mapping[int, int]
    setups: frozenset[int]
    by_campaign: Mapping[int, int]
    stay: int
    """Cells of the old campaigns that stay."""

    @property
    def runs(self) -> int:
        """Number of runs that go."""
        return len(self.run)

    @property
    def cells(self) -> int:
        """Number of cells that go."""
        return sum(len(level) for level in self.levels)


@dataclass(frozen=True, slots=True)
class _Cells:
    """Cells of old campaigns, shape (n,) each; 0 for a reference that is not there. `pair`: code of setup and parameter set."""

    id: Integers
    campaign: Integers
    run: Integers
    reference: Integers
    pair: Integers
    copied: Bools


def mark(connection: Connection, old: Collection[int], best: Mapping[int, Collection[int]]) -> Doomed:
    """Returns what goes of the campaigns `old`, by number, whose `best` parameter sets stay. Call it in one snapshot."""
    needs = _Needs(connection, old)
    cells = needs.read_cells(best)
    needs.read_runs()
    needs.close(cells)
    return needs.doomed(cells)


class _Needs:
    def __init__(self, connection: Connection, old: Collection[int]) -> None:
        self._connection = connection
        self._old = np.array(sorted(old), dtype=np.int64)
        self._cells = np.zeros(_largest(connection, evaluations.c.id) + 1, dtype=np.bool_)
        self._runs = np.zeros(_largest(connection, runs.c.id) + 1, dtype=np.bool_)
        self._sets = _largest(connection, parameter_sets.c.id) + 1
        self._copied_pairs: list[Integers] = []

    def read_cells(self, best: Mapping[int, Collection[int]]) -> _Cells:
        """Marks the cells of other campaigns, with all that they refer to, and the best sets of the old ones."""
        own: list[Integers] = []
        table = evaluations.c
        copied = case((table.outcome.in_(COPIED), 1), else_=0)
        query = select(
            *(table.id, table.campaign_sequence, table.setup_id, table.parameter_set_id),
            *(func.coalesce(column, 0) for column in (table.run_id, table.reference)),
            copied,
        )
        kept_sets = {number: np.array(sorted(sets), dtype=np.int64) for number, sets in best.items()}
        for rows in _chunks(self._connection, query):
            mine = np.isin(rows[:, 1], self._old)
            others = rows[~mine]
            self._need(others[:, 0], others[:, 4], others[:, 5])
            self._copied_pairs.append(self._pairs(others[others[:, -1] == 1]))
            ours = rows[mine]
            own.append(ours)
            for number in np.unique(ours[:, 1]):
                here = ours[ours[:, 1] == number]
                self._cells[here[np.isin(here[:, 3], kept_sets.get(int(number), ())), 0]] = True
        none = np.zeros((0, len(query.selected_columns)), dtype=np.int64)
        listed = np.concatenate(own) if own else none
        return _Cells(listed[:, 0], listed[:, 1], listed[:, 4], listed[:, 5], self._pairs(listed), listed[:, -1] == 1)

    def read_runs(self) -> None:
        """Reads which cell made each run, and its setup."""
        self._origin = np.zeros(len(self._runs), dtype=np.int64)
        self._setup = np.zeros(len(self._runs), dtype=np.int64)
        pairs = np.zeros(len(self._runs), dtype=np.int64)
        query = select(runs.c.id, runs.c.evaluation_id, runs.c.setup_id, runs.c.parameter_set_id)
        for rows in _chunks(self._connection, query):
            self._origin[rows[:, 0]] = rows[:, 1]
            self._setup[rows[:, 0]] = rows[:, 2]
            pairs[rows[:, 0]] = rows[:, 2] * self._sets + rows[:, 3]
        self._order = np.argsort(pairs, kind="stable")
        self._sorted = pairs[self._order]
        self._need_runs_of(np.concatenate([np.zeros(0, dtype=np.int64), *self._copied_pairs]))

    def close(self, cells: _Cells) -> None:
        """Marks what marked cells and runs refer to, until nothing more is marked."""
        marked = -1
        while marked != (marked := int(self._cells.sum() + self._runs.sum())):
            self._cells[self._origin[self._runs]] = True
            here = self._cells[cells.id]
            self._need(cells.id[here], cells.run[here], cells.reference[here])
            self._need_runs_of(cells.pair[here & cells.copied])

    def doomed(self, cells: _Cells) -> Doomed:
        """Returns the cells that are not marked. A cell goes after cells that refer to it or to the run that it made."""
        goes = ~self._cells[cells.id]
        ids = cells.id[goes]
        made = np.zeros(len(self._cells), dtype=np.int64)
        free = np.flatnonzero(~self._runs & (self._origin > 0))
        made[self._origin[free]] = free
        targets = np.stack([cells.reference[goes], self._origin[cells.run[goes]]])
        targets[targets == ids] = 0
        levels: list[Integers] = []
        alive = np.ones(len(ids), dtype=np.bool_)
        while alive.any():
            referred = np.zeros(len(self._cells), dtype=np.bool_)
            referred[targets[:, alive].ravel()] = True
            now = alive & ~referred[ids]
            levels.append(np.sort(ids[now if now.any() else alive])[::-1])
            alive &= ~now if now.any() else False
        runs_of = {int(cell): int(made[cell]) for cell in ids if made[cell]}
        gone = frozenset(int(setup) for setup in np.unique(self._setup[list(runs_of.values())])) if runs_of else frozenset()
        numbers, counts = np.unique(cells.campaign[goes], return_counts=True)
        by_campaign = dict(zip(numbers.tolist(), counts.tolist(), strict=True))
        return Doomed(tuple(levels), runs_of, gone, by_campaign, len(cells.id) - len(ids))

    def _need(self, ids: Integers, run: Integers, reference: Integers) -> None:
        for numbers in (ids, reference):
            self._cells[numbers] = True
        self._runs[run] = True
        self._cells[0] = self._runs[0] = False  # stands for no reference

    def _need_runs_of(self, pairs: Integers) -> None:
        """Marks the runs of these very cells: a copied score gives way to them."""
        if len(pairs) == 0 or len(self._sorted) == 0:
            return
        places = np.minimum(np.searchsorted(self._sorted, pairs), len(self._sorted) - 1)
        self._runs[self._order[places[self._sorted[places] == pairs]]] = True

    def _pairs(self, rows: Integers) -> Integers:
        pairs: Integers = rows[:, 2] * self._sets + rows[:, 3]
        return pairs


def _largest(connection: Connection, column: Column[int]) -> int:
    return connection.scalar(select(func.max(column))) or 0


def _chunks(connection: Connection, query: Select[tuple[int, ...]]) -> Iterator[Integers]:
    for rows in connection.execute(query.execution_options(yield_per=CHUNK)).partitions():
        yield np.fromiter(chain.from_iterable(rows), dtype=np.int64).reshape(len(rows), -1)


_TABLES = (evaluations, runs, ratings, reference_keys)
_PRAGMAS = ("page_count", "freelist_count", "page_size")


def bytes_of(connection: Connection, doomed: Doomed) -> int:
    """Returns about how many bytes the doomed rows take, indexes included: their share of the cells and runs of the database."""
    cells = connection.scalar(select(func.count()).select_from(evaluations)) or 0
    made = connection.scalar(select(func.count()).select_from(runs)) or 0
    share = (doomed.cells + doomed.runs) / max(1, cells + made)
    return round(share * _total(connection))


def _total(connection: Connection) -> int:
    if connection.dialect.name == "sqlite":
        pages, free, size = (connection.exec_driver_sql(f"PRAGMA {name}").scalar_one() for name in _PRAGMAS)
        return int((pages - free) * size)
    names = [table.name for table in _TABLES]
    query = text("SELECT sum(pg_total_relation_size(CAST(name AS regclass))) FROM unnest(CAST(:names AS text[])) AS name")
    return int(connection.scalar(query, {"names": names}) or 0)

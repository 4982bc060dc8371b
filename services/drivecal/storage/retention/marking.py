"""Marks what stays of old campaigns: their best sets, and everything that a cell that stays refers to.

Reads all cells and runs once and keeps some 100 bytes of each in memory, so that no index is needed for what is asked once in months.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain

import numpy as np
import numpy.typing as npt
from sqlalchemy import Column, Connection, Select, case, func, select, text

from drivecal.domain.evaluations import COPIED
from drivecal.storage.engine.tables import evaluations, parameter_sets, ratings, reference_keys, runs

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
        listed = np.concatenate(own) if own else np.zeros((0, 7), dtype=np.int64)
        return _Cells(listed[:, 0], listed[:, 1], listed[:, 4], listed[:, 5], self._pairs(listed), listed[:, -1] == 1)

    def read_runs(self) -> None:
        """Reads which cell made each run, and in which setup."""
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
        """Returns the cells that are not marked. A cell goes after those that refer to it or to the run that it made."""
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

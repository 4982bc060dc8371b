"""Stored parameter sets that might have answered a cell, read in chunks: the explanation of an answer compares them with it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from sqlalchemy import Connection, Select, SmallInteger, literal, select, tuple_, type_coerce

from drivecal.domain.evaluations import Outcome
from drivecal.storage.engine.tables import evaluations, parameter_sets, ratings, runs
from drivecal.storage.references.parameter_sets import parse
from drivecal.storage.results import StoredEvaluation

Integers = npt.NDArray[np.int64]
SETS_AT_A_TIME = 20_000
"""Some 20 MB of memory."""


@dataclass(frozen=True, slots=True)
class Candidates:
    """Parameter sets that have a result in one setup, all of the same parameters.

    `values` are in billionths, shape (n, n_p), with columns in the requested order. `places` (campaign, stage, iteration, individual),
    shape (n, 4), order references. `evaluations` are the ids of the evaluations that simulated the sets, shape (n,).
    """

    values: Integers
    places: Integers
    evaluations: Integers


def stored_sets(
    connection: Connection, setup_id: int, evaluator: str, watermark: int, names: Sequence[str]
) -> Iterator[Candidates]:
    """The sets of a setup's runs that `evaluator` rated, both up to `watermark`. Sets of other parameters than `names` are left out: they
    are of another function."""
    origin = (runs.c.campaign_sequence, type_coerce(runs.c.stage, SmallInteger), runs.c.iteration, runs.c.individual)
    query = (
        select(runs.c.evaluation_id, *origin, parameter_sets.c.parameter_values)
        .join(parameter_sets)
        .join(ratings, (ratings.c.run_id == runs.c.id) & (ratings.c.evaluator == evaluator))
        .where(runs.c.setup_id == setup_id, runs.c.id <= watermark, ratings.c.since <= watermark)
        .order_by(runs.c.id)
    )
    yield from _chunks(connection, query, names)


def own_sets(connection: Connection, cell: StoredEvaluation, names: Sequence[str]) -> Iterator[Candidates]:
    """The sets that the campaign of a cell has simulated in the cell's setup before it."""
    table = evaluations.c
    place = (table.stage, table.iteration, table.individual)
    origin = (table.campaign_sequence, type_coerce(table.stage, SmallInteger), table.iteration, table.individual)
    # Typed one by one: a tuple does not hand its types on, and stages are stored as numbers.
    before = tuple_(*(literal(getattr(cell, column.name), column.type) for column in place))
    query = (
        select(table.id, *origin, parameter_sets.c.parameter_values)
        .join(parameter_sets)
        .where(
            table.campaign_sequence == cell.campaign_sequence,
            table.scenario == cell.scenario,
            table.setup_id == cell.setup_id,  # studies drive the same sets in other vehicles
            table.plan == Outcome.SIMULATED,
            table.outcome == Outcome.SIMULATED,
            table.run_id.is_not(None),
            tuple_(*place) < before,
        )
    )
    yield from _chunks(connection, query, names)


def _chunks(connection: Connection, query: Select[Any], names: Sequence[str]) -> Iterator[Candidates]:
    streamed = connection.execute(query.execution_options(yield_per=SETS_AT_A_TIME))
    for rows in streamed.partitions():
        heads = np.array([row[:-1] for row in rows], dtype=np.int64)
        for present, positions, values in parse([row[-1] for row in rows]):
            if set(present) == set(names):
                order = [present.index(name) for name in names]
                yield Candidates(values[:, order], heads[positions, 1:], heads[positions, 0])

"""Stored sets that a cell could have reused, read in chunks, so that any table fits into memory."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from sqlalchemy import Connection, Row, Select, SmallInteger, literal, select, tuple_, type_coerce

from drivecal.domain.campaigns import StageName
from drivecal.storage.engine.tables import evaluations, parameter_sets, ratings, runs
from drivecal.storage.evaluations import DONORS
from drivecal.storage.references.parameter_sets import parse

Integers = npt.NDArray[np.int64]
CHUNK = 20_000
"""Sets per chunk: some 20 MB of memory."""


@dataclass(frozen=True, slots=True)
class ReferenceCandidates:
    """Parameter sets that have a result in one setup, all of the same parameters.

    `values` in billionths, shape (n, n_p), columns in the order asked for; `places`: what references are ordered by (campaign, stage,
    iteration, individual), shape (n, 4); `evaluations`: the ids of those that simulated them, shape (n,).
    """

    values: Integers
    places: Integers
    evaluations: Integers


def stored_sets(
    connection: Connection, setup_id: int, evaluator: str, watermark: int, names: Sequence[str]
) -> Iterator[ReferenceCandidates]:
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


def own_sets(
    connection: Connection,
    campaign_sequence: int,
    scenario: str,
    before: tuple[StageName, int, int],
    names: Sequence[str],
) -> Iterator[ReferenceCandidates]:
    """The sets that the campaign itself has simulated in a scenario before a (stage, iteration, individual)."""
    place = (evaluations.c.stage, evaluations.c.iteration, evaluations.c.individual)
    # Typed one by one: a tuple does not hand its types on, and stages are stored as numbers.
    limit = tuple_(*(literal(value, column.type) for value, column in zip(before, place, strict=True)))
    query = (
        select(
            evaluations.c.id,
            evaluations.c.campaign_sequence,
            type_coerce(evaluations.c.stage, SmallInteger),
            evaluations.c.iteration,
            evaluations.c.individual,
            parameter_sets.c.parameter_values,
        )
        .join(parameter_sets)
        .where(
            evaluations.c.campaign_sequence == campaign_sequence,
            evaluations.c.scenario == scenario,
            evaluations.c.plan.in_(DONORS),
            evaluations.c.outcome.in_(DONORS),
            evaluations.c.run_id.is_not(None),
            tuple_(*place) < limit,
        )
    )
    yield from _chunks(connection, query, names)


def _chunks(connection: Connection, query: Select[Any], names: Sequence[str]) -> Iterator[ReferenceCandidates]:
    streamed = connection.execute(query.execution_options(yield_per=CHUNK))
    for rows in streamed.partitions():
        yield from _parsed(rows, names)


def _parsed(rows: Sequence[Row[Any]], names: Sequence[str]) -> Iterator[ReferenceCandidates]:
    heads = np.array([row[:-1] for row in rows], dtype=np.int64)
    for present, positions, values in parse([row[-1] for row in rows]):
        if set(present) == set(names):
            order = [present.index(name) for name in names]
            yield ReferenceCandidates(values[:, order], heads[positions, 1:], heads[positions, 0])

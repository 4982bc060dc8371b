"""Parameter sets, each stored once, with exact values; sets which might have answered a cell are read in chunks."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from sqlalchemy import Connection, Row, Select, SmallInteger, literal, select, tuple_, type_coerce

from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Outcome
from drivecal.domain.parameters import ParameterSet
from drivecal.domain.values import BILLION, code
from drivecal.storage.engine.bulk import insert, rows_among
from drivecal.storage.engine.tables import evaluations, parameter_sets, ratings, runs


def ensure(connection: Connection, given: Sequence[ParameterSet]) -> list[int]:
    """The ids of parameter sets, in order; new ones are stored. Safe while others store the same sets."""
    keys = [parameter_set.key for parameter_set in given]
    known = ids(connection, list(dict.fromkeys(keys)))
    missing: dict[bytes, str] = {}
    for key, parameter_set in zip(keys, given, strict=True):
        if key not in known and key not in missing:
            missing[key] = parameter_set.to_json()
    if missing:
        # Sorted, so that two transactions that store the same sets wait for each other instead of deadlocking.
        rows = [{"key": key, "parameter_values": missing[key]} for key in sorted(missing)]
        connection.execute(insert(connection, parameter_sets).on_conflict_do_nothing(index_elements=["key"]), rows)
        known.update(ids(connection, list(missing)))
    return [known[key] for key in keys]


def load(connection: Connection, ids: Sequence[int]) -> dict[int, ParameterSet]:
    """Parameter sets by id. Ids that are not stored are left out."""
    query = select(parameter_sets.c.id, parameter_sets.c.parameter_values)
    rows = rows_among(connection, query, parameter_sets.c.id, [int(identifier) for identifier in ids])
    return {number: ParameterSet.from_json(values) for number, values in rows}


def parse(texts: Sequence[str]) -> Iterator[tuple[tuple[str, ...], list[int], npt.NDArray[np.int64]]]:
    """Stored `parameter_values` as numbers, fast, in groups of the same parameters in the same order.

    Returns for each group the names, the positions in `texts`, and the values in billionths, texts of choices as `domain.values.code`,
    shape (n, n_p). Reading the decimals as floats is exact: with |v| <= 1e6, v * 1e9 is off by less than a quarter, which rounding removes.
    """
    groups: dict[tuple[str, ...], tuple[list[int], list[list[float | str]]]] = {}
    for position, document in enumerate(json.loads(f"[{','.join(texts)}]")):
        positions, values = groups.setdefault(tuple(document), ([], []))
        positions.append(position)
        values.append(list(document.values()))
    for names, (positions, values) in groups.items():
        yield names, positions, np.column_stack([_column(column) for column in zip(*values, strict=True)])


def _column(values: Sequence[float | str]) -> npt.NDArray[np.int64]:
    """Returns the values of a parameter as integers, shape (n,). A name may stand for a number in one problem and a choice in another."""
    if any(isinstance(value, str) for value in values):
        return np.array([code(value) if isinstance(value, str) else round(value * BILLION) for value in values], dtype=np.int64)
    return np.rint(np.array(values, dtype=np.float64) * BILLION).astype(np.int64)


def ids(connection: Connection, keys: Sequence[bytes]) -> dict[bytes, int]:
    """Returns the ids of stored sets, by key."""
    query = select(parameter_sets.c.key, parameter_sets.c.id)
    return dict(rows_among(connection, query, parameter_sets.c.key, keys))


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


def own_sets(
    connection: Connection, campaign_sequence: int, scenario: str, before: tuple[StageName, int, int], names: Sequence[str]
) -> Iterator[Candidates]:
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
            evaluations.c.plan == Outcome.SIMULATED,
            evaluations.c.outcome == Outcome.SIMULATED,
            evaluations.c.run_id.is_not(None),
            tuple_(*place) < limit,
        )
    )
    yield from _chunks(connection, query, names)


def _chunks(connection: Connection, query: Select[Any], names: Sequence[str]) -> Iterator[Candidates]:
    streamed = connection.execute(query.execution_options(yield_per=SETS_AT_A_TIME))
    for rows in streamed.partitions():
        yield from _parsed(rows, names)


def _parsed(rows: Sequence[Row[Any]], names: Sequence[str]) -> Iterator[Candidates]:
    heads = np.array([row[:-1] for row in rows], dtype=np.int64)
    for present, positions, values in parse([row[-1] for row in rows]):
        if set(present) == set(names):
            order = [present.index(name) for name in names]
            yield Candidates(values[:, order], heads[positions, 1:], heads[positions, 0])

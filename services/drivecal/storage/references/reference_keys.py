"""Reference keys of stored runs under an influence map: one indexed look-up answers a population (Figure 6 of the paper).

The reference for a key must depend neither on the time when keys are computed, nor on results that other campaigns store meanwhile. Among
the runs up to a campaign's watermark, the first in the order of (campaign, stage, iteration, individual) wins. Workers finish in any order,
so this run may be stored late. Therefore a key keeps each run that precedes all runs with a smaller id: for every watermark, the last kept
run up to it wins. If a rating is younger than its run, the number of the rating (`since`) replaces the run's id here.

The answer of a donor (evaluation, score, rating, failure) is copied to its key, because runs and ratings never change. So a look-up reads
one tree only, and not the rows of runs, which are ten times as large and lie all over the table.

Each evaluator has an index of its own, with the runs that it has rated: a run without its rating answers no cell, and must not hide a later
run with one. The data up to a campaign's watermark decide which runs it can rate (`runs.insert_results`), so all campaigns with this
watermark agree.
"""

from collections.abc import Callable, Sequence
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt
from sqlalchemy import Connection, Row, Select, select

from drivecal.domain.evaluations import Donor
from drivecal.storage.engine.bulk import insert, rows_among
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.tables import parameter_sets, ratings, reference_indexes, reference_keys, runs
from drivecal.storage.references.parameter_sets import parse
from drivecal.storage.references.runs import ORIGIN

KeyFunction = Callable[[tuple[str, ...], npt.NDArray[np.int64]], Sequence[bytes]]
"""Maps names and values in billionths, shape (n, n_p), to n keys of 16 bytes."""
RUNS_AT_A_TIME = 50_000
"""Some 100 MB of memory, and other writers wait for about a second."""

_COLUMNS = "reference_keys (index_id, key, run_id, evaluation_id, score, rating, failure, since)"
_COPIED = (runs.c.evaluation_id, ratings.c.score, ratings.c.rating, runs.c.failure, ratings.c.since)


def look_up(
    connection: Connection, influence_map_sequence: int, setup_id: int, keys: Sequence[bytes], evaluator: str, watermark: int
) -> dict[bytes, Donor]:
    """The first references of `keys` among the runs that `evaluator` rated, both up to `watermark`. Call it after `sync`."""
    index = connection.scalar(_index(influence_map_sequence, setup_id, evaluator))
    if index is None:
        return {}
    table = reference_keys.c
    query = select(table.key, table.since, table.evaluation_id, table.run_id, table.score, table.rating, table.failure)
    query = query.where(table.index_id == index, table.run_id <= watermark, table.since <= watermark)
    newest: dict[bytes, tuple[int, Donor]] = {}
    rows = rows_among(connection, query, table.key, sorted(keys))  # in the order of the tree
    for key, since, evaluation, run, score, rating, failure in rows:
        number = since or run
        if key not in newest or number > newest[key][0]:
            newest[key] = number, Donor(evaluation, run, score, rating, failure)
    return {key: donor for key, (_, donor) in newest.items()}


def sync(
    database: Database,
    influence_map_sequence: int,
    setup_id: int,
    evaluator: str,
    upto_run_id: int,
    key_function: KeyFunction,
    chunk: int = RUNS_AT_A_TIME,
) -> int:
    """Computes the missing keys of one setup's runs up to `upto_run_id` that `evaluator` has rated. Returns their number.

    Call it when the evaluator has rated the runs (`ratings`): runs that are rated later get no key. Works in transactions of `chunk` runs,
    and continues after an interruption.
    """
    total = 0
    while True:
        with database.transaction() as connection:
            index = _ensure_index(connection, influence_map_sequence, setup_id, evaluator)
            done = _sync_chunk(connection, index, setup_id, evaluator, upto_run_id, key_function, chunk)
        total += done
        if done < chunk:
            return total


def _sync_chunk(
    connection: Connection, index: int, setup_id: int, evaluator: str, upto: int, key_function: KeyFunction, chunk: int
) -> int:
    since = _since(connection, index)
    rows = _rated(connection, setup_id, evaluator, since, upto, chunk)
    if rows:
        keys = _keys(rows, key_function)
        first = {} if since == 0 else _first(connection, index, sorted(set(keys)))
        records: list[tuple[Any, ...]] = []
        for key, row in zip(keys, rows, strict=True):
            place = tuple(row[1 + len(_COPIED) : -1])  # the origin
            if key not in first or place < first[key]:
                first[key] = place
                records.append((index, key, *row[: 1 + len(_COPIED)]))
        _insert(connection, sorted(records))  # no two have the same index, key and run
    reached = max(_number(rows[-1]) if len(rows) == chunk else upto, since)
    connection.execute(reference_indexes.update().where(reference_indexes.c.id == index).values(run_id=reached))
    return len(rows)


def _rated(connection: Connection, setup_id: int, evaluator: str, after: int, upto: int, chunk: int) -> Sequence[Row[Any]]:
    """Returns the next `chunk` runs that the evaluator rated, by number: id, columns that keys copy, origin, parameter set."""
    query = (
        select(runs.c.id, *_COPIED, *ORIGIN, parameter_sets.c.parameter_values)
        .join(parameter_sets)
        .join(ratings, (ratings.c.run_id == runs.c.id) & (ratings.c.evaluator == evaluator))
        .limit(chunk)
    )
    first = query.where(runs.c.setup_id == setup_id, ratings.c.since == 0, runs.c.id > after, runs.c.id <= upto)
    # "+ 0", or SQLite would go through all runs of the setup in search of the few late ratings, which have an index of their own
    late = query.where(runs.c.setup_id + 0 == setup_id, ratings.c.since > 0, ratings.c.since > after, ratings.c.since <= upto)
    both = connection.execute(first.order_by(runs.c.id)), connection.execute(late.order_by(ratings.c.since))
    return sorted(chain(*both), key=_number)[:chunk]


def _number(row: Row[Any]) -> int:
    """Returns the first watermark that sees a row of `_rated`."""
    number: int = row.since or row.id
    return number


def _index(influence_map: int, setup_id: int, evaluator: str) -> Select[int]:
    return select(reference_indexes.c.id).where(
        reference_indexes.c.influence_map_sequence == influence_map,
        reference_indexes.c.setup_id == setup_id,
        reference_indexes.c.evaluator == evaluator,
    )


def _ensure_index(connection: Connection, influence_map: int, setup_id: int, evaluator: str) -> int:
    existing = connection.scalar(_index(influence_map, setup_id, evaluator))
    if existing is not None:
        return existing
    row = {"influence_map_sequence": influence_map, "setup_id": setup_id, "evaluator": evaluator, "run_id": 0}
    connection.execute(insert(connection, reference_indexes).on_conflict_do_nothing(), row)
    return connection.execute(_index(influence_map, setup_id, evaluator)).scalar_one()


def _since(connection: Connection, index: int) -> int:
    """Returns the last run with a key. Locks the row, so that one process syncs at a time."""
    query = select(reference_indexes.c.run_id).where(reference_indexes.c.id == index).with_for_update()
    since: int = connection.execute(query).scalar_one()
    return since


def _keys(rows: Sequence[Row[Any]], key_function: KeyFunction) -> list[bytes]:
    keys = [b""] * len(rows)
    for names, positions, values in parse([row.parameter_values for row in rows]):
        for position, key in zip(positions, key_function(names, values), strict=True):
            keys[position] = key
    return keys


def _first(connection: Connection, index: int, keys: Sequence[bytes]) -> dict[bytes, tuple[int, ...]]:
    """Returns the earliest origin of each stored key."""
    query = (
        select(reference_keys.c.key, *ORIGIN)
        .join(runs, runs.c.id == reference_keys.c.run_id)
        .where(reference_keys.c.index_id == index)
    )
    first: dict[bytes, tuple[int, ...]] = {}
    for key, *origin in rows_among(connection, query, reference_keys.c.key, keys):
        first[key] = min(first.get(key, tuple(origin)), tuple(origin))
    return first


def _insert(connection: Connection, rows: Sequence[tuple[Any, ...]]) -> None:
    """Inserts rows by the drivers themselves: with a million rows, SQLAlchemy would take most of the time."""
    if connection.dialect.name == "postgresql":
        driver: Any = connection.connection.driver_connection
        with driver.cursor() as cursor, cursor.copy(f"COPY {_COLUMNS} FROM STDIN (FORMAT BINARY)") as copy:
            copy.set_types(["int8", "bytea", "int8", "int8", "float8", "float8", "text", "int8"])
            for row in rows:
                copy.write_row(row)
    elif rows:
        connection.exec_driver_sql(f"INSERT INTO {_COLUMNS} VALUES (?, ?, ?, ?, ?, ?, ?, ?)", rows)  # noqa: S608  # a constant

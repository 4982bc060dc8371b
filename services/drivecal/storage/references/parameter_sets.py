"""Parameter sets, each stored once, with exact values."""

import json
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt
from sqlalchemy import Connection, select

from drivecal.domain.parameters import ParameterSet
from drivecal.domain.values import BILLION, code
from drivecal.storage.engine.bulk import insert, rows_among
from drivecal.storage.engine.tables import parameter_sets


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

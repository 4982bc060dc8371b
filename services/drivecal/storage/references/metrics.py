"""Metrics of runs, stored as a text of floats whose names are stored once.

The names of a simulator's metrics take four times the place of their values, and are the same in millions of runs. Metrics that
are no floats are documents with names. Names are stored under the digest of their content, so that a
remembered digest is right whatever transaction was rolled back.
"""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable, Mapping, Sequence
from hashlib import blake2b
from math import isfinite, nan
from typing import Any
from weakref import WeakKeyDictionary

from sqlalchemy import Connection, Engine, select

from drivecal.storage.engine.bulk import insert
from drivecal.storage.engine.tables import metric_names
from drivecal.storage.engine.types import finite

Metrics = Mapping[str, float | None]
Stored = str | dict[str, Any]
"""Content of the column: `DIGEST:FLOATS` or a document."""
_KNOWN: WeakKeyDictionary[Engine, dict[str, tuple[str, ...]]] = WeakKeyDictionary()


def pack(connection: Connection, given: Sequence[Mapping[str, float]]) -> list[Stored]:
    """Returns metrics as they are stored, in order, and stores their names."""
    digests: dict[tuple[str, ...], str] = {}
    packed: list[Stored] = []
    for metrics in given:
        names = tuple(metrics)
        if names and all(type(value) is float for value in metrics.values()):
            if names not in digests:
                digest = blake2b(json.dumps(names).encode(), digest_size=9).digest()
                digests[names] = base64.urlsafe_b64encode(digest).decode()
            numbers = [value if isfinite(value) else nan for value in metrics.values()]
            packed.append(f"{digests[names]}:{base64.b64encode(struct.pack(f'<{len(numbers)}d', *numbers)).decode()}")
        else:
            packed.append(finite(dict(metrics)))
    stored = set(connection.scalars(select(metric_names.c.digest).where(metric_names.c.digest.in_(digests.values()))))
    rows = [{"digest": digest, "names": list(names)} for names, digest in digests.items() if digest not in stored]
    if rows:
        statement = insert(connection, metric_names).on_conflict_do_nothing(index_elements=["digest"])
        connection.execute(statement, sorted(rows, key=lambda row: str(row["digest"])))
    return packed


def reader(connection: Connection) -> Callable[[Stored], dict[str, float | None]]:
    """Returns a function that reads stored metrics; None for values that were not finite."""
    known = _KNOWN.setdefault(connection.engine, {})

    def read(stored: Stored) -> dict[str, float | None]:
        if not isinstance(stored, str):
            return stored
        digest, _, content = stored.partition(":")
        if digest not in known:
            rows = connection.execute(select(metric_names.c.digest, metric_names.c.names))
            known.update((row.digest, tuple(row.names)) for row in rows)
        values = struct.unpack(f"<{len(known[digest])}d", base64.b64decode(content))
        return {name: value if isfinite(value) else None for name, value in zip(known[digest], values, strict=True)}

    return read

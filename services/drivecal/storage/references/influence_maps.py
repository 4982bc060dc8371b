"""Influence maps: influential ranges of parameters, from expert knowledge or from an analysis."""

import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, bindparam, null, select

from drivecal.storage.engine.records import identified, page_by, record
from drivecal.storage.engine.tables import influence_maps
from drivecal.storage.engine.types import now


@dataclass(frozen=True, slots=True)
class StoredInfluenceMap:
    """An influence map as it is stored. `sequence` names it in the functions of `reference_keys`."""

    sequence: int
    id: str
    name: str
    source: str
    driving_function: str
    parameters: Any
    """Parameters of the map, or those it was checked against, with their grids, as a JSON document."""
    scenarios: Mapping[str, Any]
    """Influence by scenario and parameter, as a JSON document; None in a list."""
    basis: Mapping[str, Any] | None
    """Basis of the analysis: fixed values, setups, evaluator, settings; None for a map that a user posted."""
    created_at: datetime


def insert(
    connection: Connection,
    *,
    name: str,
    source: str,
    driving_function: str,
    parameters: Any,
    scenarios: Mapping[str, Any],
    basis: Mapping[str, Any] | None = None,
) -> StoredInfluenceMap:
    """Stores a map; `parameters` and `scenarios` are JSON documents."""
    statement = influence_maps.insert().values(
        id=uuid.uuid4().hex,
        name=name,
        source=source,
        driving_function=driving_function,
        parameters=parameters,
        scenarios=dict(scenarios),
        basis=None if basis is None else dict(basis),
        created_at=now(),
    )
    return record(StoredInfluenceMap, connection.execute(statement.returning(influence_maps)).one())


def get(connection: Connection, map_id: str) -> StoredInfluenceMap:
    """A map by its id or its first characters. Raises NotFoundError."""
    query = select(influence_maps).where(influence_maps.c.id == bindparam("identifier"))
    return record(StoredInfluenceMap, identified(connection, query, "influence map", map_id, select(influence_maps.c.id)))


def page(connection: Connection, *, limit: int = 50, cursor: str | None = None) -> tuple[list[StoredInfluenceMap], str | None]:
    """At most `limit` maps, newest first, without scenarios and basis (megabytes); the next page's cursor. Raises InvalidInputError."""
    listed = [null().label(each.name) if each.name in {"scenarios", "basis"} else each for each in influence_maps.c]
    rows, following = page_by(connection, select(*listed), influence_maps.c.sequence, limit, cursor)
    return [record(StoredInfluenceMap, row) for row in rows], following

"""Results of vehicles, test benches and other tools. No look-up of the reference table reads them."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from sqlalchemy import Connection, delete, false, func, or_, select

from drivecal.domain.errors import ConflictError
from drivecal.domain.parameters import ParameterSet
from drivecal.storage.admission import alone
from drivecal.storage.engine.bulk import execute_rows, insert, rows_among
from drivecal.storage.engine.records import record
from drivecal.storage.engine.tables import imported_results, parameter_sets
from drivecal.storage.engine.types import now
from drivecal.storage.references import parameter_sets as sets

MOST = 100_000
"""Cells from elsewhere that a problem may have."""


@dataclass(frozen=True, slots=True)
class ImportedValues:
    """Values of a set in a scenario from elsewhere. `date` is in ISO 8601."""

    source: str
    date: str
    owner: str | None
    scenario: str
    parameters: ParameterSet
    scores: Mapping[str, float]
    measures: Mapping[str, float]
    form: str
    """Digest of the problem's curves and maps, to which the set belongs."""


def add(connection: Connection, problem: str, given: Sequence[ImportedValues]) -> int:
    """Stores results of a problem, by name, and returns how many are new; equal ones are stored once.

    The rows are of one source and date. Raises ConflictError if a cell has other values already, or the problem has too many cells.
    """
    alone(connection)
    table = imported_results.c
    ids = sets.ensure(connection, [each.parameters for each in given])
    places: dict[tuple[int, str], ImportedValues] = {}
    for number, each in zip(ids, given, strict=True):
        if places.setdefault((number, each.scenario), each) != each:
            raise ConflictError(
                f"{each.source} has two results of {each.date} for {each.parameters.floats} in {each.scenario}; keep one"
            )
    own = select(imported_results).where(table.problem == problem, table.source == given[0].source, table.date == given[0].date)
    for row in rows_among(connection, own, table.parameter_set_id, sorted(set(ids))):
        if (row.parameter_set_id, row.scenario) not in places:
            continue
        each = places.pop((row.parameter_set_id, row.scenario))
        if (row.scores, row.measures, row.form) != (dict(each.scores), dict(each.measures), each.form):
            raise ConflictError(
                f"{row.source} has other values of {row.date} for {each.parameters.floats} in {row.scenario}, or of other curves; "
                "delete them first"
            )
    count = connection.scalar(select(func.count()).where(table.problem == problem)) or 0
    if count + len(places) > MOST:
        raise ConflictError(f"{problem} would have {count + len(places):,} imported cells, at most {MOST:,}; delete a source")
    as_it_is = ("source", "date", "owner", "scenario", "scores", "measures", "form")
    rows = [
        {name: getattr(each, name) for name in as_it_is} | {"problem": problem, "parameter_set_id": number, "created_at": now()}
        for (number, _), each in places.items()
    ]
    execute_rows(connection, insert(connection, imported_results), rows)
    return len(rows)


def listing(connection: Connection, problem: str, source: str | None = None) -> list[ImportedValues]:
    """Returns a problem's results, all or from one source, in the order of their storage."""
    table = imported_results.c
    query = select(imported_results, parameter_sets.c.parameter_values).join(parameter_sets).where(table.problem == problem)
    if source is not None:
        query = query.where(table.source == source)
    rows = connection.execute(query.order_by(table.id))
    return [record(ImportedValues, row, parameters=ParameterSet.from_json(row.parameter_values)) for row in rows]


def owners(connection: Connection, problem: str, source: str) -> set[str | None]:
    """Returns who stored the results of a source."""
    table = imported_results.c
    return set(connection.scalars(select(table.owner).where(table.problem == problem, table.source == source).distinct()))


def remove(connection: Connection, problem: str, source: str, owners: Collection[str | None]) -> int:
    """Deletes the results of a source that these owners stored, and returns how many there were."""
    table = imported_results.c
    stored_by = or_(false(), *(table.owner.is_not_distinct_from(owner) for owner in owners))
    return connection.execute(
        delete(imported_results).where(table.problem == problem, table.source == source, stored_by)
    ).rowcount

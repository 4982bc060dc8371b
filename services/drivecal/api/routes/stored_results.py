"""Look-ups of stored results; results of vehicles, test benches and other tools."""

import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response
from pydantic import Field
from sqlalchemy import Connection

from drivecal.api.dependencies import Accept, DatabaseDependency, Owner, computed
from drivecal.api.http.authorisation import refuse_others
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.http.queries import Parameters, TableOf
from drivecal.api.tables.paging import listed, page_or_file
from drivecal.bundles.units import same
from drivecal.campaigns.resolve.bench import Bench
from drivecal.campaigns.resolve.spaces import Function, free_values
from drivecal.campaigns.resolve.workbench import bench_of, stored_bundles
from drivecal.configuration.tokens import Token
from drivecal.contracts.outside.imported import (
    MOST_CELLS,
    ImportAnswer,
    ImportDeleted,
    ImportedResults,
    ResultLookup,
    StoredCell,
    StoredCells,
)
from drivecal.contracts.specification import ProblemSpecification, Values
from drivecal.contracts.strict_json import ProblemName, Source
from drivecal.contracts.tables import ImportedRow, Kind, columns_of
from drivecal.domain.errors import ConflictError, Diagnostics, InvalidInputError, Problem
from drivecal.domain.evaluations import Donor, Rating
from drivecal.domain.parameters import ParameterSet
from drivecal.storage import bundles
from drivecal.storage.engine.database import Database
from drivecal.storage.outside import imported
from drivecal.storage.outside.imported import ImportedValues
from drivecal.storage.references import parameter_sets, runs, setups

router = APIRouter(prefix="/results", tags=["evaluations"], route_class=StrictRoute)
PATHS = "/api/v1/results", "/api/v1/results/lookup"
BODY_MB = 8
"""Ten thousand sets of many parameters."""


@router.post("/lookup")
@computed
def look_up(wanted: ResultLookup, database: DatabaseDependency) -> StoredCells:
    """Which of up to 10,000 cells are stored, with their answers. Nothing is simulated, and nothing is stored."""
    bench = bench_of(ProblemSpecification.model_validate(wanted.model_dump(exclude={"sets"})), stored_bundles(database))
    if bench.to_probe is not None:
        raise ConflictError("results of this problem depend on versions that a worker reports; ask by POST /api/v1/evaluations")
    requested = len(wanted.sets) * len(bench.scenarios)
    if requested > MOST_CELLS:
        message = f"{len(wanted.sets):,} sets in {len(bench.scenarios):,} scenarios are {requested:,} cells"
        raise InvalidInputError(Problem("sets", message, f"give at most {MOST_CELLS:,}"))
    sets = given_sets(bench, wanted.sets, "sets[{}]", Diagnostics())
    return StoredCells(requested=requested, items=database.query(stored_simulations, bench, sets))


@router.post("", status_code=201)
@computed
def store(given: ImportedResults, database: DatabaseDependency, owner: Owner) -> ImportAnswer:
    """Stores results from elsewhere. No campaign takes one in place of a simulation. The same again changes nothing."""
    bench = bench_of(ProblemSpecification(problem=given.problem), stored_bundles(database))
    _check(given, bench)
    diagnostics = Diagnostics()
    sets = given_sets(bench, [row.parameters for row in given.rows], "rows[{}].parameters", diagnostics)
    different = {each.key: each.floats for each in sets}.values()
    for parameter in bench.parameters:
        values = [each[parameter.name] for each in different]
        if beyond := sum(parameter.nearest(value) is None for value in values):
            diagnostics.notes.append(f"{parameter.name}: {beyond:,} of {len(values):,} values are not {parameter.extent}")
    manifest = bench.bundle.manifest
    rows = [
        ImportedValues(given.source, given.date.isoformat(), owner, row.scenario, own, row.scores, row.measures, manifest.form)
        for row, own in zip(given.rows, sets, strict=True)
    ]
    with database.transaction() as connection:
        stored = imported.add(connection, manifest.problem, rows)
    known = len({(row.scenario, row.parameters.key) for row in rows}) - stored
    return ImportAnswer(stored=stored, known=known, notes=diagnostics.notes)


class ImportedOf(TableOf):
    """Results from elsewhere of a problem, of one source or all."""

    problem: ProblemName
    source: Source | None = None


@router.get("", responses=page_or_file(ImportedRow))
@computed
def list_imported(query: Annotated[ImportedOf, Query()], database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """Results from elsewhere: scores and measures, their values in stored simulations of the same sets, and the differences."""
    problem = database.query(bundles.named, query.problem).name
    rows = database.query(imported.listing, problem, query.source)
    values = {name: value for row in rows for name, value in row.parameters.floats.items()}
    kinds: dict[str, Kind] = {name: "text" if isinstance(value, str) else "number" for name, value in values.items()}
    columns = columns_of(ImportedRow, {"parameters": kinds})
    return listed(f"results-{problem}", query, accept, columns, _beside_simulations(database, problem, rows))


class SourceOf(Parameters):
    """A source of results from elsewhere."""

    problem: ProblemName
    source: Annotated[Source, Field()]


@router.delete("")
def delete(query: Annotated[SourceOf, Query()], request: Request, database: DatabaseDependency) -> ImportDeleted:
    """Deletes what one imported of a source; an admin deletes all of it."""
    token: Token = request.state.token
    with database.transaction() as connection:
        problem = bundles.named(connection, query.problem).name
        known = imported.owners(connection, problem, query.source)
        own = [owner for owner in known if token.may_steer(owner)]
        for owner in () if own else known:
            refuse_others(request, query.source, owner, "source")
        return ImportDeleted(deleted=imported.remove(connection, problem, query.source, own))


def _check(given: ImportedResults, bench: Bench) -> None:
    """Raises InvalidInputError for names that the problem does not have, and for units that differ from its own."""
    manifest, diagnostics = bench.bundle.manifest, Diagnostics()
    known: Mapping[str, Collection[str]] = {
        "scores": manifest.scores,
        "measures": manifest.reported,
        "scenario": bench.scenarios,
    }
    units = {name: entry.unit for name, entry in (manifest.scalars | manifest.parameters).items()} | manifest.reported
    for name, unit in given.units.items():
        own = units.get(name)
        if own is None:
            diagnostics.add(f"units.{name}", "the problem has no such parameter or measure", f"one of {', '.join(units)}")
        elif not same(unit, own):
            diagnostics.add(f"units.{name}", f"the problem has it in {own}, not in {unit}", f"convert the values to {own}")
    for number, row in enumerate(given.rows):
        for kind, names in (("scores", row.scores), ("measures", row.measures), ("scenario", [row.scenario])):
            for name in names:
                if name not in known[kind]:
                    field = f"rows[{number}].{kind}" if kind == "scenario" else f"rows[{number}].{kind}.{name}"
                    diagnostics.add(field, f"the problem has no {name!r} there", f"one of {', '.join(known[kind])}")
    diagnostics.raise_if_any()


_Simulated = tuple[Bench, Mapping[tuple[int, str], StoredCell]]
"""A bench, and the stored simulations that it rated, by place of the imported set and scenario."""


def _beside_simulations(database: Database, problem: str, rows: Sequence[ImportedValues]) -> list[ImportedRow]:
    if not rows:
        return []
    first = _simulated(database, problem, rows, None)
    own, *others = first[0].bundle.manifest.scores
    names = {name for row in rows for name in row.scores}
    scores = {own: first} | {name: _simulated(database, problem, rows, name) for name in others if name in names}
    return [item for place, row in enumerate(rows) for item in _items(place, row, first, scores)]


def _simulated(database: Database, problem: str, rows: Sequence[ImportedValues], evaluator: str | None) -> _Simulated:
    bench = bench_of(ProblemSpecification(problem=problem, evaluator=evaluator), stored_bundles(database))
    sets = [row.parameters for row in rows]
    with database.read() as connection:  # results that depend on what workers report are not found: a look-up asks no worker
        simulations = stored_simulations(connection, bench, sets) if bench.to_probe is None else []
    form = bench.bundle.manifest.form  # a set of other curves has no simulation
    return bench, {(each.set, each.scenario): each for each in simulations if rows[each.set].form == form}


def _items(place: int, row: ImportedValues, first: _Simulated, scores: Mapping[str, _Simulated]) -> Iterator[ImportedRow]:
    """Yields a row for each score, which may follow from the measures, and for each measure."""
    (first_bench, cells), cell = first, (place, row.scenario)
    measures, units = cells[cell].metrics if cell in cells else {}, first_bench.bundle.manifest.reported
    values: list[tuple[Literal["score", "measure"], str, str | None, float | None, float | None]] = []
    for name, (bench, simulated) in scores.items():
        made = bench.rate(row.scenario, row.measures, None) if row.scenario in bench.scenarios else None
        value = row.scores.get(name, None if made is None else made.score)
        values.append(("score", name, None, value, simulated[cell].score if cell in simulated else None))
    values += [("score", name, None, value, None) for name, value in row.scores.items() if name not in scores]  # renamed since
    values += [("measure", name, units.get(name), value, measures.get(name)) for name, value in row.measures.items()]
    for kind, name, unit, value, known in values:
        if value is not None:
            both = {"value": value, "simulated": known, "difference": None if known is None else value - known}
            yield ImportedRow.of(row, parameters=row.parameters.floats, kind=kind, name=name, unit=unit, **both)


def given_sets(bench: Bench, given: Sequence[Values], field: str, diagnostics: Diagnostics) -> list[ParameterSet]:
    """Returns parameter sets with a value for each parameter; adds notes. Raises InvalidInputError with each fault, by field and number."""
    function = Function(bench.function, {"": bench.parameters}, {}, {}, bench.bundle.manifest.shapes)
    sets = [free_values(each, function, field.format(number), diagnostics) for number, each in enumerate(given)]
    diagnostics.raise_if_any()
    return [ParameterSet.of(values) for values in sets]


def stored_simulations(connection: Connection, bench: Bench, sets: Sequence[ParameterSet]) -> list[StoredCell]:
    """Returns the stored simulations of sets in the bench's scenarios, by place, under the bench's seed.

    Runs that were rated by another score only are rated from their measures, unless the score needs their time series.
    """
    ids = parameter_sets.ids(connection, [each.key for each in sets])
    known = setups.ids(connection, [setup.fingerprint for setup in bench.setups.values()])
    places: dict[int, list[int]] = {}
    for place, each in enumerate(sets):
        if each.key in ids:
            places.setdefault(ids[each.key], []).append(place)
    items = []
    for scenario, setup in bench.setups.items():
        if setup.fingerprint not in known:
            continue
        rated = runs.look_up_exact(connection, known[setup.fingerprint], list(places), bench.evaluator_id, sys.maxsize)
        for run in runs.of_sets(connection, known[setup.fingerprint], list(places)):
            answer: Donor | Rating | None = rated.get(run.parameter_set)
            if answer is None and not bench.needs_series:
                answer = bench.rate(scenario, run.metrics, run.failure)
            if answer is not None:
                about = {"scenario": scenario, "score": answer.score, "rating": answer.rating}
                items += [StoredCell.of(run, set=place, **about) for place in places[run.parameter_set]]
    return sorted(items, key=lambda item: item.set)

"""Look-ups of stored results."""

import sys

from fastapi import APIRouter
from sqlalchemy import Connection

from drivecal.api.dependencies import DatabaseDependency, computed
from drivecal.api.http.bodies import StrictRoute
from drivecal.campaigns.resolve.bench import Bench
from drivecal.campaigns.resolve.diagnostics import Diagnostics
from drivecal.campaigns.resolve.workbench import find_workbench, stored_bundles
from drivecal.contracts.outside.results import MOST_CELLS, ResultLookup, StoredCell, StoredCells
from drivecal.contracts.specification import EvaluationSpecification
from drivecal.domain.errors import ConflictError, InvalidInputError, Problem
from drivecal.domain.parameters import ParameterSet, decimal
from drivecal.storage.references import parameter_sets, runs, setups

router = APIRouter(prefix="/results", tags=["evaluations"], route_class=StrictRoute)
PATH = "/api/v1/results/lookup"
BODY_MB = 8
"""Ten thousand sets of many parameters."""


@router.post("/lookup")
@computed
def look_up(wanted: ResultLookup, database: DatabaseDependency) -> StoredCells:
    """Which of up to 10,000 cells are stored, with their answers. Nothing is simulated, and nothing is stored."""
    diagnostics = Diagnostics()
    document = wanted.model_dump(exclude={"sets"}) | {"parameters": wanted.sets[0]}
    workbench = find_workbench(EvaluationSpecification.model_validate(document), stored_bundles(database), diagnostics)
    diagnostics.raise_if_any()
    if workbench.make is None:
        raise AssertionError("a part is missing without a finding")
    bench = workbench.make(workbench.scenarios)
    if bench.to_probe is not None:
        raise ConflictError("results of this problem depend on versions that a worker reports; ask by POST /api/v1/evaluations")
    requested = len(wanted.sets) * len(bench.scenarios)
    if requested > MOST_CELLS:
        message = f"{len(wanted.sets):,} sets in {len(bench.scenarios):,} scenarios are {requested:,} cells"
        raise InvalidInputError(Problem("sets", message, f"give at most {MOST_CELLS:,}"))
    sets = _sets(wanted, bench)
    with database.read() as connection:
        return StoredCells(requested=requested, items=_stored(connection, bench, sets))


def _sets(wanted: ResultLookup, bench: Bench) -> list[ParameterSet]:
    names = [parameter.name for parameter in bench.parameters]
    diagnostics = Diagnostics()
    for number, given in enumerate(wanted.sets):
        for name in given.keys() - set(names):
            diagnostics.add(f"sets[{number}].{name}", "there is no such parameter", f"one of {', '.join(names)}")
        for name in names:
            if name not in given:
                diagnostics.add(f"sets[{number}].{name}", "the value is missing", "give one value per parameter")
    diagnostics.raise_if_any()
    values = [{name: given[name] for name in names} for given in wanted.sets]
    return [
        ParameterSet.of({name: value if isinstance(value, str) else decimal(value) for name, value in each.items()})
        for each in values
    ]


def _stored(connection: Connection, bench: Bench, sets: list[ParameterSet]) -> list[StoredCell]:
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
        donors = runs.look_up_exact(connection, known[setup.fingerprint], list(places), bench.evaluator_id, sys.maxsize)
        measured = runs.metrics(connection, [donor.run for donor in donors.values()])
        items += [
            StoredCell.of(donor, set=place, scenario=scenario, metrics=measured[donor.run])
            for number, donor in donors.items()
            for place in places[number]
        ]
    return sorted(items, key=lambda item: item.set)

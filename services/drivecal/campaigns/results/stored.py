"""Stored simulations of given cells, rated by a bench. Nothing is simulated, and nothing is stored."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import Connection

from drivecal.campaigns.resolve.bench import Bench
from drivecal.campaigns.resolve.diagnostics import Diagnostics
from drivecal.campaigns.resolve.spaces import Function, free_values
from drivecal.contracts.specification import Values
from drivecal.domain.parameters import ParameterSet
from drivecal.storage.references import parameter_sets, runs, setups


@dataclass(frozen=True, slots=True)
class StoredSimulation:
    """The simulation of the set at a `place` among the given ones, and the `evaluation` that made it. Metrics that were not finite are
    None."""

    place: int
    scenario: str
    evaluation: int
    score: float
    rating: float
    failure: str | None
    metrics: dict[str, float | None]


def given_sets(bench: Bench, given: Sequence[Values], field: str, diagnostics: Diagnostics) -> list[ParameterSet]:
    """Returns parameter sets with a value for each parameter; adds notes. Raises InvalidInputError with each fault, in `field` with its
    number."""
    function = Function(bench.function, {"": bench.parameters}, {}, {}, bench.bundle.manifest.shapes)
    sets = [free_values(each, function, field.format(number), diagnostics) for number, each in enumerate(given)]
    diagnostics.raise_if_any()
    return [ParameterSet.of(values) for values in sets]


def stored_simulations(connection: Connection, bench: Bench, sets: Sequence[ParameterSet]) -> list[StoredSimulation]:
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
            donor = rated.get(run.parameter_set)
            if donor is not None:
                score, rating = donor.score, donor.rating
            elif bench.needs_series or (made := bench.rate(scenario, run.metrics, run.failure)) is None:
                continue
            else:
                score, rating = made.score, made.rating
            items += [
                StoredSimulation(place, scenario, run.evaluation, score, rating, run.failure, dict(run.metrics))
                for place in places[run.parameter_set]
            ]
    return sorted(items, key=lambda item: item.place)

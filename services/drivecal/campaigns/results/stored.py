"""Stored simulations of given cells, rated by a bench. Nothing is simulated, and nothing is stored."""

import sys
from collections.abc import Sequence

from sqlalchemy import Connection

from drivecal.campaigns.resolve.bench import Bench
from drivecal.campaigns.resolve.spaces import Function, free_values
from drivecal.contracts.outside.imported import StoredCell
from drivecal.contracts.specification import Values
from drivecal.domain.errors import Diagnostics
from drivecal.domain.evaluations import Donor, Rating
from drivecal.domain.parameters import ParameterSet
from drivecal.storage.references import parameter_sets, runs, setups


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

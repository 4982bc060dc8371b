"""Rates the metrics of stored runs with another evaluator, in bulk, instead of simulating the runs again."""

import logging

from drivecal.campaigns.cells.planning import View, ensure_setups
from drivecal.domain.parameters import ParameterSet
from drivecal.storage.engine.database import Database
from drivecal.storage.references import parameter_sets, ratings

log = logging.getLogger(__name__)

CHUNK = 10_000
"""Runs per transaction: some 20 MB of metrics."""


def rate_stored_runs(database: Database, view: View, only: ParameterSet | None = None, chunk: int = CHUNK) -> int:
    """Rates every visible run that the campaign's evaluator has not rated; returns the number of new ratings.

    `only` limits this to one parameter set. Call it before planning: the campaign then sees every possible rating, and other campaigns add
    none. Failed runs are worth the scale's `failed` with every evaluator. Runs that lack the evaluator's metrics stay unrated and are
    simulated when needed; so do successful runs if it needs time series. Resumable: rated runs are skipped.
    """
    listed = view.bench.seeded(1)  # a started campaign lists the setups of its first seed alone
    fingerprints = view.bench.fingerprints | listed.fingerprints
    with database.transaction() as connection:
        if ratings.are_all_by(connection, view.bench.evaluator_id, fingerprints):
            return 0
        setup_ids = ensure_setups(connection, view.bench)
        number = None if only is None else parameter_sets.ensure(connection, [only])[0]
    bench, evaluator_id = view.bench, view.bench.evaluator_id
    total = missing = 0
    for scenario, setup_id in setup_ids.items():
        reached = 0
        while True:
            unrated = database.query(
                ratings.unrated,
                setup_id,
                evaluator_id,
                after=reached,
                upto=view.watermark,
                limit=chunk,
                parameter_set_id=number,
                only_failed=bench.needs_series,
            )
            if not unrated:
                break
            ratings_of = [(run.id, bench.rate(scenario, run.metrics, run.failure)) for run in unrated]
            rated = [(run, rating) for run, rating in ratings_of if rating is not None]
            with database.transaction() as connection:
                ratings.insert(connection, evaluator_id, rated)
            total, missing, reached = total + len(rated), missing + len(unrated) - len(rated), unrated[-1].id
    if total or missing:
        log.info("%s rated %d stored runs; %d lack what it asks for", evaluator_id, total, missing)
    return total

"""Submission of comparisons, and their expected cost."""

from sqlalchemy import Connection

from drivecal.api.dependencies import Limits
from drivecal.api.submission import accepted_before, digests_of, named_map, pace
from drivecal.campaigns.comparisons.resolve import ComparisonProblem, queue, resolve_comparison
from drivecal.campaigns.resolve.bundle_source import stored_bundles
from drivecal.contracts.comparison import ComparisonSpecification, ExpectedComparison
from drivecal.domain.errors import Problem, TooLargeError
from drivecal.storage import admission
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database


def submit(database: Database, limits: Limits, specification: ComparisonSpecification, key: str | None) -> StoredCampaign:
    """Queues a comparison with its runs.

    Raises InvalidInputError if it cannot run, TooLargeError, and OverloadError if the queue is full.
    """
    digests = digests_of("comparisons", specification)
    earlier = accepted_before(database, key, digests)
    if earlier is not None:
        return earlier
    problem = _checked(database, limits, specification)
    with database.transaction() as connection:
        admission.admit(connection, limits.queued_campaigns, key)
        return queue(connection, problem, _map(connection, problem), key, digests)


def expected(database: Database, limits: Limits, specification: ComparisonSpecification) -> ExpectedComparison:
    """Returns the expected cost of a comparison. Raises InvalidInputError and TooLargeError as `submit` does."""
    problem = _checked(database, limits, specification)
    with database.read() as connection:
        _map(connection, problem)
        setups = problem.problems[0].bench.setups.values()  # all runs share them
        known = pace(connection, [setup.fingerprint for setup in setups])
    return ExpectedComparison(
        runs=len(problem.runs),
        proposed=problem.proposed,
        at_most=problem.at_most,
        milliseconds=known.milliseconds,
        measured=known.measured,
        workers=known.workers,
        seconds=known.seconds(problem.at_most),
        notes=list(dict.fromkeys(note for resolved in problem.problems for note in resolved.notes)),
    )


def _checked(database: Database, limits: Limits, specification: ComparisonSpecification) -> ComparisonProblem:
    problem = resolve_comparison(specification, stored_bundles(database))
    if problem.proposed > limits.largest_campaign:
        message = f"the {len(problem.runs):,} runs of the comparison may propose {problem.proposed:,} cells"
        remedy = (
            f"this server takes {limits.largest_campaign:,}; reduce populations, iterations, seeds, optimizers or scenarios"
        )
        raise TooLargeError(Problem("populations", message, remedy))
    return problem


def _map(connection: Connection, problem: ComparisonProblem) -> str | None:
    """Returns the id of the influence map that the comparison names. Raises InvalidInputError if it does not hold for the runs."""
    return next((named_map(connection, row) for row in problem.problems if row.specification.sensitivity is not None), None)

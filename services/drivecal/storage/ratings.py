"""Ratings of stored runs by other evaluators than the one that rated them first.

They follow from the metrics that are stored with a run, so that whether an evaluator has an opinion of a run does not depend on when,
or for which campaign, it was asked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sqlalchemy import Connection, exists, select

from drivecal.domain.evaluations import Rating
from drivecal.storage.membership import insert as insert_into
from drivecal.storage.tables import ratings, runs


@dataclass(frozen=True, slots=True)
class UnratedRun:
    """A run that an evaluator has not rated; a metric is None where it was not finite."""

    id: int
    metrics: Mapping[str, float | None]
    failure: str | None


def unrated(
    connection: Connection,
    setup_id: int,
    evaluator: str,
    *,
    after: int,
    upto: int,
    limit: int,
    parameter_set_id: int | None = None,
) -> list[UnratedRun]:
    """At most `limit` of a setup's runs, `after` < id <= `upto`, that `evaluator` ("name version") has not rated, ordered by id;
    with `parameter_set_id` only that of this parameter set."""
    rated = exists().where(ratings.c.run_id == runs.c.id, ratings.c.evaluator == evaluator)
    query = (
        select(runs.c.id, runs.c.metrics, runs.c.failure)
        .where(runs.c.setup_id == setup_id, runs.c.id > after, runs.c.id <= upto, ~rated)
        .order_by(runs.c.id)
        .limit(limit)
    )
    if parameter_set_id is not None:
        query = query.where(runs.c.parameter_set_id == parameter_set_id)
    return [UnratedRun(row.id, row.metrics, row.failure) for row in connection.execute(query)]


def insert(connection: Connection, evaluator: str, found: Sequence[tuple[int, Rating]]) -> None:
    """Stores an evaluator's ratings of runs by their id; one that is there already stays."""
    rows = [{"run_id": one, "evaluator": evaluator, "score": rating.score, "rating": rating.rating} for one, rating in found]
    if rows:
        statement = insert_into(connection, ratings).on_conflict_do_nothing(index_elements=["run_id", "evaluator"])
        connection.execute(statement, rows)

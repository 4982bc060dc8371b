"""Ratings of stored runs by other evaluators than their first one.

They follow from the metrics that are stored with a run, so that whether an evaluator has an opinion of a run does not depend on when,
or for which campaign, it was asked. (Ratings that a run is simulated again for are written down by `runs.insert_results`.)
"""

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from sqlalchemy import Connection, exists, func, or_, select

from drivecal.domain.evaluations import Rating
from drivecal.storage.engine.bulk import insert as insert_into
from drivecal.storage.engine.tables import campaigns, ratings, runs
from drivecal.storage.references import metrics


def are_all_by(connection: Connection, evaluator: str, fingerprints: Collection[str]) -> bool:
    """True if every campaign that may have simulated in these setups used `evaluator` ("name version"): it has rated all their runs then,
    for results are stored with their ratings. Reads campaigns only; there may be millions of runs."""
    resolved = campaigns.c.resolution
    used = func.coalesce(resolved["evaluator"].as_string(), "")
    others = campaigns.c.started_at.is_not(None), used != evaluator
    varied = campaigns.c.spec["robustness"].as_string().is_not(None)  # with other vehicles, whose setups no resolution lists
    anywhere = exists().where(*others, or_(resolved["setups"].as_string().is_(None), varied))
    if connection.scalar(select(anywhere)):
        return False
    setups = select(resolved["setups"].as_string()).where(*others).distinct()
    return not any(set(fingerprints) & set(json.loads(listed).values()) for listed in connection.scalars(setups))


@dataclass(frozen=True, slots=True)
class UnratedRun:
    """A run that an evaluator has not rated; a metric is None if it was not finite."""

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
    only_failed: bool = False,
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
    if only_failed:
        query = query.where(runs.c.failure.is_not(None))
    read = metrics.reader(connection)
    return [UnratedRun(row.id, read(row.metrics), row.failure) for row in connection.execute(query)]


def insert(connection: Connection, evaluator: str, rated: Sequence[tuple[int, Rating]]) -> None:
    """Stores an evaluator's ratings of runs by their id; stored ratings stay."""
    rows = [{"run_id": run, "evaluator": evaluator, "score": rating.score, "rating": rating.rating} for run, rating in rated]
    if rows:
        statement = insert_into(connection, ratings).on_conflict_do_nothing(index_elements=["run_id", "evaluator"])
        connection.execute(statement, rows)

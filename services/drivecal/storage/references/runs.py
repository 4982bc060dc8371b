"""The reference table: simulated results, each (setup, parameter set) once, and their ratings by evaluator."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import repeat
from statistics import fmean
from typing import Any

from sqlalchemy import ColumnElement, Connection, Select, SmallInteger, case, func, select, type_coerce

from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Donor
from drivecal.domain.parameters import ParameterSet
from drivecal.storage.engine.bulk import execute_rows, insert, numbers, rows_among
from drivecal.storage.engine.records import record
from drivecal.storage.engine.tables import parameter_sets, ratings, runs, setups
from drivecal.storage.engine.types import finite, now
from drivecal.storage.references.metrics import Stored
from drivecal.storage.references.metrics import pack as pack_metrics
from drivecal.storage.references.metrics import reader as metrics_reader

RECENT_RUNS = 1_000
"""Newest runs of a setup whose mean predicts the cost of the next."""


@dataclass(frozen=True, slots=True)
class NewRun:
    """A simulated result, rated by `evaluator` ("name version"), and the evaluation that it comes from.

    `milliseconds`: CPU time of the run alone, without a second one; the evaluation's own `milliseconds` include it.
    `wall_milliseconds`: wall-clock time on the worker, None for simulations that never wait.
    """

    setup_id: int
    parameter_set_id: int
    metrics: Mapping[str, float]
    failure: str | None
    milliseconds: float
    worker: str
    evaluator: str
    score: float
    rating: float
    evaluation_id: int
    campaign_sequence: int
    stage: StageName
    iteration: int
    individual: int
    from_series: bool = False
    """The rating says what the evaluator saw in the time series, and does not follow from the metrics."""
    wall_milliseconds: float | None = None


@dataclass(frozen=True, slots=True)
class StoredRun:
    """The reference table's result for a cell after `insert_results`: this result or an earlier one.

    `agrees`: False if an earlier result of the same cell differs in any bit of metrics, failure or, by the same evaluator, score or
    rating, so that something that decides runs is missing in the setup's fingerprint.
    """

    id: int
    evaluation_id: int
    agrees: bool
    is_whole: bool = True
    """It has all measures of the new result: a problem may declare further ones."""


def occupying() -> ColumnElement[float]:
    """Time (ms) for which a run occupied its worker: CPU time, or wall-clock time if its simulator waited."""
    wall = func.coalesce(runs.c.wall_milliseconds, runs.c.milliseconds)
    return case((wall > runs.c.milliseconds, wall), else_=runs.c.milliseconds)


@dataclass(frozen=True, slots=True)
class Worked:
    """A run at a worker: the time at which its result was stored, and the seconds for which it occupied the worker."""

    worker: str
    campaign_sequence: int
    created_at: datetime
    seconds: float
    id: int = 0


def newest_work(connection: Connection, most: int, after: int = 0) -> list[Worked]:
    """Returns the newest runs, the newest first; only those with a larger number than `after`."""
    columns = runs.c.worker, runs.c.campaign_sequence, runs.c.created_at, (occupying() / 1000).label("seconds"), runs.c.id
    query = select(*columns).where(runs.c.id > after).order_by(runs.c.id.desc()).limit(most)
    return [record(Worked, row) for row in connection.execute(query)]


def insert_results(connection: Connection, results: Sequence[NewRun]) -> list[StoredRun]:
    """Stores results exactly once and returns the stored run of each, in order. The first result of a cell stays.

    A rating is stored together with its run, or follows from the run's stored metrics (`ratings`): a campaign that sees the run sees both.
    Only a rating `from_series` needs a new simulation of a stored run. If this returns the stored bits, the rating gets a number of its
    own, so that only later campaigns see it.
    """
    if not results:
        return []
    new = _insert(connection, results)
    _insert_ratings(connection, {(run, result.evaluator): result for run, result in new.values()}, repeat(0))
    ids = {id(result): run for run, result in new.values()}
    compared = iter(_compare(connection, [result for result in results if id(result) not in ids]))
    return [
        StoredRun(ids[id(result)], result.evaluation_id, agrees=True) if id(result) in ids else next(compared)
        for result in results
    ]


def largest_id(connection: Connection) -> int:
    """The number of the newest run, or of the newest rating of an older one: the watermark of a campaign that starts now. 0 for none."""
    newest = connection.scalar(select(func.max(runs.c.id))) or 0
    return max(newest, connection.scalar(select(func.max(ratings.c.since)).where(ratings.c.since > 0)) or 0)


def stocked(connection: Connection, setup_ids: Collection[int]) -> set[int]:
    """Returns the setups that have runs: one query instead of a look-up for each."""
    any_run = select(runs.c.id).where(runs.c.setup_id == setups.c.id).exists()
    return {row.id for row in rows_among(connection, select(setups.c.id).where(any_run), setups.c.id, sorted(setup_ids))}


def look_up_exact(
    connection: Connection, setup_id: int, parameter_set_ids: Sequence[int], evaluator: str, watermark: int
) -> dict[int, Donor]:
    """The stored results of parameter sets in one setup, by parameter set id; of runs that `evaluator` rated, both up to `watermark`."""
    donor = runs.c.evaluation_id, runs.c.id, ratings.c.score, ratings.c.rating, runs.c.failure
    query = rated_by(evaluator, setup_id, watermark, runs.c.parameter_set_id, *donor)
    ids = sorted(int(identifier) for identifier in parameter_set_ids)
    return {identifier: Donor(*donor) for identifier, *donor in rows_among(connection, query, runs.c.parameter_set_id, ids)}


@dataclass(frozen=True, slots=True)
class RatedRun:
    """A stored run."""

    id: int
    parameters: ParameterSet
    score: float
    rating: float


def rated(
    connection: Connection, setup_id: int, evaluator: str, watermark: int, limit: int, stage: StageName | None = None
) -> list[RatedRun]:
    """Returns the last `limit` runs of a setup up to `watermark`, of one `stage` or all, in the order of references."""
    query = rated_by(evaluator, setup_id, watermark, *_RATED).join(parameter_sets)
    query = query if stage is None else query.where(runs.c.stage == stage)
    rows = connection.execute(query.order_by(*(column.desc() for column in (*ORIGIN, runs.c.id))).limit(limit)).all()
    return [RatedRun(number, ParameterSet.from_json(values), score, rating) for number, values, score, rating in reversed(rows)]


def in_order_of_keys(
    connection: Connection, setup_id: int, evaluator: str, watermark: int, names: Collection[str], others: Collection[str]
) -> Iterator[RatedRun]:
    """Returns a setup's runs up to `watermark` by the keys of their sets, which is a random order: sets with all `names` and none of the
    `others`. The connection must stay open meanwhile."""
    query = (
        rated_by(evaluator, setup_id, watermark, *_RATED)
        .join(parameter_sets)
        .order_by(parameter_sets.c.key)
        .execution_options(yield_per=100)
    )
    wanted, unwanted = ([f'"{name}": ' for name in each] for each in (names, others))  # SQLite's LIKE would ignore case
    for number, text, score, rating in connection.execute(query):
        if all(key in text for key in wanted) and not any(key in text for key in unwanted):
            yield RatedRun(number, ParameterSet.from_json(text), score, rating)


def rated_by(evaluator: str, setup_id: int, watermark: int, *columns: ColumnElement[Any]) -> Select[Any]:
    """Selects columns of a setup's runs that an evaluator rated, and of their ratings, both up to a watermark. `+ 0` hides the ids
    from planners, which would read a whole setup by them, and sort."""
    joined = select(*columns).join(ratings, (ratings.c.run_id == runs.c.id) & (ratings.c.evaluator == evaluator))
    return joined.where(runs.c.setup_id == setup_id, runs.c.id + 0 <= watermark, ratings.c.since <= watermark)


_RATED = runs.c.id, parameter_sets.c.parameter_values, ratings.c.score, ratings.c.rating
"""The columns of `RatedRun`."""
ORIGIN = runs.c.campaign_sequence, type_coerce(runs.c.stage, SmallInteger), runs.c.iteration, runs.c.individual
"""The columns that order references. Stages have their numbers here: they are ordered as they run, not by name."""


def values_of(connection: Connection, run_ids: Collection[int]) -> dict[int, tuple[dict[str, float | None], str | None]]:
    """Returns metrics and failure of runs by id."""
    query = select(runs.c.id, runs.c.metrics, runs.c.failure)
    rows, read = rows_among(connection, query, runs.c.id, sorted(run_ids)), metrics_reader(connection)
    return {number: (read(stored), failure) for number, stored, failure in rows}


@dataclass(frozen=True, slots=True)
class RunOfSet:
    """A stored run with the `evaluation` that simulated it; a metric is None if it was not finite."""

    parameter_set: int
    evaluation: int
    metrics: Mapping[str, float | None]
    failure: str | None


def of_sets(connection: Connection, setup_id: int, parameter_set_ids: Sequence[int]) -> list[RunOfSet]:
    """Returns the runs of parameter sets in a setup."""
    query = select(runs.c.parameter_set_id, runs.c.evaluation_id, runs.c.metrics, runs.c.failure)
    rows = rows_among(connection, query.where(runs.c.setup_id == setup_id), runs.c.parameter_set_id, sorted(parameter_set_ids))
    read = metrics_reader(connection)
    return [RunOfSet(row[0], row[1], read(row[2]), row[3]) for row in rows]


def _insert(connection: Connection, results: Sequence[NewRun]) -> dict[tuple[int, int], tuple[int, NewRun]]:
    """Stores results of cells that have none: by cell, the run's id and the result that it is."""
    created_at = now()
    statement = insert(connection, runs).on_conflict_do_nothing(index_elements=["setup_id", "parameter_set_id"])
    packed = pack_metrics(connection, [result.metrics for result in results])
    ids = numbers(connection, runs.c.id, len(results))
    rows = zip(ids, results, packed, strict=True)
    execute_rows(connection, statement, [_row(number, result, stored, created_at) for number, result, stored in rows])
    new = {row.id for row in rows_among(connection, select(runs.c.id), runs.c.id, ids)}
    return {_key(result): (number, result) for number, result in zip(ids, results, strict=True) if number in new}


def _compare(connection: Connection, results: Sequence[NewRun]) -> list[StoredRun]:
    """Returns the earlier results of cells, and whether the new ones agree."""
    if not results:
        return []
    known = _stored(connection, results)
    stored, read = [known[_key(result)] for result in results], metrics_reader(connection)
    before, values = [read(run.metrics) for run in stored], [finite(dict(result.metrics)) for result in results]
    repeats = [
        run.failure == result.failure and all(old.get(name, value) == value for name, value in new.items())
        for run, result, old, new in zip(stored, results, before, values, strict=True)
    ]
    late: dict[tuple[int, str], NewRun] = {}
    for run, result, same in zip(stored, results, repeats, strict=True):
        if result.from_series and same and result.failure is None:
            late.setdefault((run.id, result.evaluator), result)
    rated = rows_among(connection, select(ratings), ratings.c.run_id, sorted({run.id for run in stored}))
    standing = {(row.run_id, row.evaluator): (row.score, row.rating) for row in rated}
    missing = {key: result for key, result in late.items() if key not in standing}
    _insert_ratings(connection, missing, numbers(connection, runs.c.id, len(missing)))
    standing |= {key: (result.score, result.rating) for key, result in missing.items()}
    return [
        StoredRun(
            id=run.id,
            evaluation_id=run.evaluation_id,
            agrees=same
            and standing.get((run.id, result.evaluator), (result.score, result.rating)) == (result.score, result.rating),
            is_whole=new.keys() <= old.keys(),
        )
        for run, result, old, new, same in zip(stored, results, before, values, repeats, strict=True)
    ]


def _key(run: NewRun) -> tuple[int, int]:
    return run.setup_id, run.parameter_set_id


def _row(number: int, run: NewRun, packed: Stored, created_at: Any) -> dict[str, Any]:
    as_it_is = ("setup_id", "parameter_set_id", "failure", "worker", "evaluation_id", "campaign_sequence", "stage")
    return {name: getattr(run, name) for name in as_it_is} | {
        "id": number,
        "metrics": packed,
        "milliseconds": float(run.milliseconds),
        "wall_milliseconds": run.wall_milliseconds,
        "iteration": int(run.iteration),
        "individual": int(run.individual),
        "created_at": created_at,
    }


def _insert_ratings(connection: Connection, new: Mapping[tuple[int, str], NewRun], since: Iterable[int]) -> None:
    """Inserts ratings, with their numbers in `since`."""
    rows = [
        {"run_id": run, "evaluator": evaluator, "score": result.score, "rating": float(result.rating), "since": number}
        for ((run, evaluator), result), number in zip(new.items(), since, strict=False)
    ]
    execute_rows(connection, insert(connection, ratings).on_conflict_do_nothing(index_elements=["run_id", "evaluator"]), rows)


def _stored(connection: Connection, results: Sequence[NewRun]) -> dict[tuple[int, int], Any]:
    wanted: dict[int, list[int]] = {}
    for result in results:
        wanted.setdefault(result.setup_id, []).append(result.parameter_set_id)
    columns = select(runs.c.parameter_set_id, runs.c.id, runs.c.evaluation_id, runs.c.failure, runs.c.metrics)
    return {
        (setup_id, row.parameter_set_id): row
        for setup_id, ids in wanted.items()
        for row in rows_among(connection, columns.where(runs.c.setup_id == setup_id), runs.c.parameter_set_id, ids)
    }


def recent_milliseconds(connection: Connection, fingerprints: Sequence[str]) -> float | None:
    """Returns the mean time (ms) for which a simulation occupies a worker: the mean over setups of the mean of the newest runs of each.
    None if a setup has no run."""
    means = []
    for (setup,) in rows_among(connection, select(setups.c.id), setups.c.fingerprint, fingerprints):
        newest = select(occupying()).where(runs.c.setup_id == setup)
        times = connection.scalars(newest.order_by(runs.c.id.desc()).limit(RECENT_RUNS)).all()
        means += [fmean(times)] if times else []
    return fmean(means) if fingerprints and len(means) == len(fingerprints) else None

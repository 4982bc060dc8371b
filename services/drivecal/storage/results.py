"""Evaluations of campaigns, read for pages, exports and rankings."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from sqlalchemy import (
    Boolean,
    ColumnElement,
    Connection,
    FromClause,
    Row,
    Select,
    SmallInteger,
    case,
    func,
    literal,
    select,
    tuple_,
    type_coerce,
)

from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import NotFoundError
from drivecal.domain.evaluations import NOT_SIMULATED, CellScore, Outcome, Purpose
from drivecal.domain.parameters import ParameterSet
from drivecal.storage.engine.bulk import rows_among
from drivecal.storage.engine.records import decode_cursor, encode_cursor
from drivecal.storage.engine.tables import evaluations, parameter_sets, ratings, runs
from drivecal.storage.engine.types import ORDER, STAGES
from drivecal.storage.evaluations import HAS_SEED, RUN_SEED, of_iteration
from drivecal.storage.references import metrics
from drivecal.storage.references.parameter_sets import parse
from drivecal.storage.references.runs import ORIGIN, rated_by

BATCH = 1_000
"""Rows that an export holds in memory at a time."""
parsed = lru_cache(10_000)(ParameterSet.from_json)
"""Reads a stored set. Each is requested in several scenarios, and read when it waits and when predictors learn its answers."""
Valued = Callable[[Mapping[str, float | None], str | None, ParameterSet], Mapping[str, float]]
"""Returns further values of a run from its metrics, its failure and the parameter set of the cell."""
_PLACE = tuple(evaluations.c[name] for name in ("stage", "iteration", "individual", "scenario", "seed"))
_COPIED = evaluations.c.outcome.in_(NOT_SIMULATED)
# Made once: an alias computes its columns anew, which takes longer than to read a small campaign.
_ANSWERING_RUN, _OWN_RUN, _OWN_RATING = runs.alias("answering_run"), runs.alias("own_run"), ratings.alias("own_rating")


class StoredEvaluation(NamedTuple):
    """A requested cell. `outcome` is None while it is pending; `plan` is the planned kind of answer."""

    id: int
    campaign_sequence: int
    stage: StageName
    iteration: int
    individual: int
    scenario: str
    setup_id: int
    parameter_set_id: int
    parameters: ParameterSet
    plan: Outcome
    outcome: Outcome | None
    score: float | None
    rating: float | None
    run_id: int | None
    reference: int | None
    purpose: Purpose
    agrees: bool | None
    failure: str | None
    milliseconds: float | None
    worker: str | None
    attempts: int
    runs: int
    detail: str | None
    """The reason of the failure, as reported by the worker or the pool."""
    lot: int | None
    confidence: float | None
    predicted_score: float | None
    predicted_rating: float | None
    seed: int
    has_seed: bool
    """False if the simulator does not depend on a seed."""


_NAMES = StoredEvaluation._fields
_OUTCOMES: dict[str | None, Outcome | None] = {None: None, **{each.value: each for each in Outcome}}
_PURPOSES = {each.value: each for each in Purpose}
_PARAMETERS, _PLAN, _OUTCOME, _PURPOSE = map(_NAMES.index, ("parameters", "plan", "outcome", "purpose"))


def by_id(connection: Connection, evaluation_id: int) -> StoredEvaluation:
    """Returns an evaluation. Raises NotFoundError."""
    row = None
    if 0 < evaluation_id < 2**63:
        row = connection.execute(_select().where(evaluations.c.id == evaluation_id)).one_or_none()
    if row is None:
        raise NotFoundError("evaluation", str(evaluation_id))
    return next(_evaluations([row]))


def cells_at(connection: Connection, campaign_sequence: int, iteration: int, individual: int, scenario: str) -> dict[int, int]:
    """Returns the numbers of a set's cells in a scenario of the calibration stage by seed, which is 0 if the simulator is not random.
    Seeds that report the set come first, then simulated cells, then copied ones, last cells without a score. Raises NotFoundError."""
    table = evaluations.c
    here = table.campaign_sequence == campaign_sequence, table.stage == StageName.CALIBRATION
    at = select(table.parameter_set_id).where(*here, table.iteration == iteration, table.individual == individual)
    number = at.limit(1).correlate(None).scalar_subquery()  # searches by the cell ask a set's scenarios at several places
    worth = case((table.score.is_(None), 3), (table.purpose == Purpose.REPORT, 0), (_COPIED, 2), else_=1)
    cells = select(table.seed, table.id).where(*here, table.scenario == scenario, table.parameter_set_id == number)
    known: dict[int, int] = {}
    for seed, cell in connection.execute(cells.order_by(worth, table.seed, *_PLACE)):
        known.setdefault(seed, cell)
    if not known:
        raise NotFoundError("evaluation", f"of individual {individual} in iteration {iteration}, {scenario}")
    return known


def number_of_sets(connection: Connection, campaign_sequence: int, stage: StageName) -> int:
    """Returns the number of different parameter sets in the cells of a stage."""
    table = evaluations.c
    here = (table.campaign_sequence == campaign_sequence, table.stage == stage)
    return int(connection.scalar(select(func.count(table.parameter_set_id.distinct())).where(*here)) or 0)


def page(
    connection: Connection, campaign_sequence: int, *, limit: int = 100, cursor: str | None = None
) -> tuple[list[StoredEvaluation], str | None]:
    """At most `limit` evaluations, ordered by stage, iteration, individual, scenario, seed, and the cursor of the next page (None on the
    last). Raises InvalidInputError."""
    query = _of_campaign(campaign_sequence).limit(limit + 1)
    if cursor is not None:
        number, *rest = decode_cursor(cursor, int, int, int, str, int)
        place = (STAGES.get(number, STAGES[len(STAGES)]), *rest)
        # Typed one by one: a tuple does not hand its types on, and stages are stored as numbers.
        typed = (literal(value, column.type) for value, column in zip(place, _PLACE, strict=True))
        query = query.where(tuple_(*_PLACE) > tuple_(*typed))
    page = list(_evaluations(connection.execute(query).all()))
    if len(page) <= limit:
        return page, None
    last = page[limit - 1]
    return page[:limit], encode_cursor(ORDER[last.stage], last.iteration, last.individual, last.scenario, last.seed)


def stream(connection: Connection, campaign_sequence: int) -> Iterator[StoredEvaluation]:
    """All evaluations of a campaign in the order of `page`, read as they are consumed; the connection must stay open meanwhile."""
    query = _of_campaign(campaign_sequence).execution_options(yield_per=BATCH)
    return _evaluations(connection.execute(query))


def pending(connection: Connection, campaign_sequence: int) -> list[StoredEvaluation]:
    """Returns the cells of a campaign that wait for their answers, in the order of their storage."""
    query = _select().where(evaluations.c.campaign_sequence == campaign_sequence, evaluations.c.outcome.is_(None))
    return list(_evaluations(connection.execute(query.order_by(evaluations.c.id))))


def answers(
    connection: Connection,
    campaign_sequence: int,
    stage: StageName,
    iteration: int | None = None,
    *,
    corrected_by: str | None = None,
    watermark: int | None = None,
    valued: Valued | None = None,
) -> Iterator[CellScore]:
    """The answered cells of one iteration, or of all, in the order of `page`, with the values that `valued` computes from the run of each;
    the connection must stay open meanwhile. A reference's run has the score of the cell, but other measures, so that it gives no values.

    With `corrected_by`, an evaluator, a copied or predicted score gives way to that of a run of the very cell, by any campaign, and so do
    its values. A search must not read its answers in this way: they would change
    after it has gone on from them. With a `watermark` only runs and ratings that a campaign with it sees correct.
    """
    table = evaluations.c
    source: FromClause = evaluations
    copied: ColumnElement[bool] = _COPIED
    score: ColumnElement[Any] = table.score
    rating: ColumnElement[Any] = table.rating
    believed = copied
    run_id: ColumnElement[Any] = case((~copied, table.run_id))
    if corrected_by is not None:
        own_run, own = _OWN_RUN, _OWN_RATING
        same_cell = (own_run.c.setup_id == table.setup_id) & (own_run.c.parameter_set_id == table.parameter_set_id)
        by_own = own.c.evaluator == corrected_by
        if watermark is not None:
            same_cell, by_own = same_cell & (own_run.c.id <= watermark), by_own & (own.c.since <= watermark)
        source = evaluations.outerjoin(own_run, copied & same_cell).outerjoin(own, (own.c.run_id == own_run.c.id) & by_own)
        score, rating = func.coalesce(own.c.score, score), func.coalesce(own.c.rating, rating)
        believed = copied & own.c.run_id.is_(None)
        run_id = case((copied, own_run.c.id), else_=table.run_id)
    own_metrics = table.metrics.label("own"), parameter_sets.c.parameter_values
    measured = (_ANSWERING_RUN.c.metrics, _ANSWERING_RUN.c.failure, *own_metrics) if valued is not None else ()
    if valued is not None:
        source = source.outerjoin(_ANSWERING_RUN, _ANSWERING_RUN.c.id == run_id)
        source = source.join(parameter_sets, parameter_sets.c.id == table.parameter_set_id)
    predicted = type_coerce(believed & (table.outcome == Outcome.PREDICTED), Boolean)
    failed = type_coerce(table.failure.is_not(None) & table.score.is_not(None), Boolean)
    told = type_coerce(~believed, Boolean), table.iteration, table.individual, predicted, RUN_SEED, failed
    query = (
        select(table.parameter_set_id, table.scenario, score, rating, *told, *measured)
        .select_from(source)
        .where(table.campaign_sequence == campaign_sequence, table.stage == stage, table.outcome.is_not(None))
        .order_by(*_PLACE)
        .execution_options(yield_per=BATCH)
    )
    if iteration is not None:
        query = query.where(table.iteration == iteration)
    read = metrics.reader(connection)
    for row in connection.execute(query):
        cell = CellScore(*row[:10])
        if valued is not None and row.metrics is not None:
            taken = read(row.metrics) if row.own is None else row.own
            cell = replace(cell, values=valued(taken, row.failure, parsed(row.parameter_values)))
        yield cell


def sets_since(connection: Connection, campaign_sequence: int, stage: StageName, iteration: int) -> list[int]:
    """The parameter sets that a stage asked for since an iteration, one after the other: their ids, in that order."""
    table = evaluations.c
    since = table.campaign_sequence == campaign_sequence, table.stage == stage, table.iteration >= iteration
    query = select(table.iteration, table.parameter_set_id).where(*since, ~HAS_SEED)  # further seeds confirm no copy
    return [number for _, number in connection.execute(query.distinct().order_by(table.iteration))]


def sets_at(connection: Connection, campaign_sequence: int, stage: StageName, iteration: int) -> dict[int, ParameterSet]:
    """Returns the parameter sets that an iteration of a stage asked for, by individual."""
    query = select(evaluations.c.individual, parameter_sets.c.parameter_values).join(parameter_sets).distinct()
    rows = connection.execute(query.where(*of_iteration(campaign_sequence, stage, iteration)))
    return {individual: parsed(values) for individual, values in rows}


def released(connection: Connection, campaign_sequence: int) -> list[StoredEvaluation]:
    """Returns the released predictions of a campaign, in the order of their request."""
    query = _of_campaign(campaign_sequence).where(evaluations.c.outcome == Outcome.PREDICTED)
    return list(_evaluations(connection.execute(query)))


def first_copy(connection: Connection, campaign_sequence: int, scenario: str, parameter_set_id: int) -> StoredEvaluation | None:
    """Returns the cell with a calibration's first answer of a parameter set, without a run of its own; None without one."""
    table = evaluations.c
    asked = table.scenario == scenario, table.parameter_set_id == parameter_set_id
    query = _select().where(table.campaign_sequence == campaign_sequence, table.stage == StageName.CALIBRATION, *asked, _COPIED)
    return next(_evaluations(connection.execute(query.order_by(*_PLACE).limit(1))), None)


def outcomes_of(connection: Connection, campaign_sequence: int, sets: Sequence[int]) -> Iterator[tuple[int, str, Outcome]]:
    """The answered cells of a calibration by the ids of their parameter sets: id, scenario and outcome, in the order of their request."""
    table = evaluations.c
    query = select(table.parameter_set_id, table.scenario, table.outcome, *_PLACE[1:3]).where(
        table.campaign_sequence == campaign_sequence, table.stage == StageName.CALIBRATION, table.outcome.is_not(None)
    )
    rows = rows_among(connection, query, table.parameter_set_id, list(sets))
    for row in sorted(rows, key=lambda row: (row.iteration, row.individual)):
        yield row.parameter_set_id, row.scenario, Outcome(row.outcome)


def is_requested(
    connection: Connection, campaign_sequence: int, stage: StageName, iteration: int, individual: int | None = None
) -> bool:
    """Returns whether cells of an iteration, or of an individual in it, were requested."""
    query = select(evaluations.c.id).where(*of_iteration(campaign_sequence, stage, iteration))
    if individual is not None:
        query = query.where(evaluations.c.individual == individual)
    return connection.execute(query.limit(1)).first() is not None


def is_pending(connection: Connection, campaign_sequence: int, stage: StageName, iteration: int) -> bool:
    """Returns whether a cell of an iteration waits for its answer."""
    query = select(evaluations.c.id).where(*of_iteration(campaign_sequence, stage, iteration), evaluations.c.outcome.is_(None))
    return connection.execute(query.limit(1)).first() is not None


def donors(connection: Connection, campaign_sequence: int, stage: StageName) -> Iterator[tuple[int, str, ParameterSet]]:
    """The simulated cells of a stage, which can answer others: id, scenario, parameter set."""
    table = evaluations.c
    query = (
        select(table.id, table.scenario, parameter_sets.c.parameter_values)
        .join(parameter_sets)
        .where(table.campaign_sequence == campaign_sequence, table.stage == stage, table.outcome == Outcome.SIMULATED)
        .order_by(table.id)
        .execution_options(yield_per=BATCH)
    )
    for number, scenario, values in connection.execute(query):
        yield number, scenario, ParameterSet.from_json(values)


def _select() -> Select[Any]:
    """Selects the columns of `StoredEvaluation`, in its order."""
    columns = {**evaluations.c, "parameters": parameter_sets.c.parameter_values, "seed": RUN_SEED, "has_seed": HAS_SEED}
    return select(*(columns[name] for name in _NAMES)).select_from(evaluations.join(parameter_sets))


def _of_campaign(campaign_sequence: int) -> Select[Any]:
    return _select().where(evaluations.c.campaign_sequence == campaign_sequence).order_by(*_PLACE)


def _evaluations(rows: Iterable[Row[Any]]) -> Iterator[StoredEvaluation]:
    for row in rows:
        values = list(row)
        values[_PARAMETERS] = parsed(values[_PARAMETERS])
        values[_PLAN], values[_OUTCOME] = _OUTCOMES[values[_PLAN]], _OUTCOMES[values[_OUTCOME]]
        values[_PURPOSE] = _PURPOSES[values[_PURPOSE]]
        yield StoredEvaluation._make(values)


Integers = npt.NDArray[np.int64]
SETS_AT_A_TIME = 20_000
"""Some 20 MB of memory."""


@dataclass(frozen=True, slots=True)
class Candidates:
    """Parameter sets that have a result in one setup, all of the same parameters.

    `values` are in billionths, shape (n, n_p), with columns in the requested order. `places` (campaign, stage, iteration, individual),
    shape (n, 4), order references. `evaluations` are the ids of the evaluations that simulated the sets, shape (n,).
    """

    values: Integers
    places: Integers
    evaluations: Integers


def stored_sets(
    connection: Connection, setup_id: int, evaluator: str, watermark: int, names: Sequence[str]
) -> Iterator[Candidates]:
    """The sets of a setup's runs that `evaluator` rated, both up to `watermark`. Sets of other parameters than `names` are left out: they
    are of another function."""
    query = rated_by(evaluator, setup_id, watermark, runs.c.evaluation_id, *ORIGIN, parameter_sets.c.parameter_values)
    yield from _chunks(connection, query.join(parameter_sets).order_by(runs.c.id), names)


def own_sets(connection: Connection, cell: StoredEvaluation, names: Sequence[str]) -> Iterator[Candidates]:
    """The sets that the campaign of a cell has simulated in the cell's setup before it."""
    table = evaluations.c
    place = (table.stage, table.iteration, table.individual)
    origin = (table.campaign_sequence, type_coerce(table.stage, SmallInteger), table.iteration, table.individual)
    # Typed one by one: a tuple does not hand its types on, and stages are stored as numbers.
    before = tuple_(*(literal(getattr(cell, column.name), column.type) for column in place))
    query = (
        select(table.id, *origin, parameter_sets.c.parameter_values)
        .join(parameter_sets)
        .where(
            table.campaign_sequence == cell.campaign_sequence,
            table.scenario == cell.scenario,
            table.setup_id == cell.setup_id,  # studies drive the same sets in other vehicles
            table.plan == Outcome.SIMULATED,
            table.outcome == Outcome.SIMULATED,
            table.run_id.is_not(None),
            tuple_(*place) < before,
        )
    )
    yield from _chunks(connection, query, names)


def _chunks(connection: Connection, query: Select[Any], names: Sequence[str]) -> Iterator[Candidates]:
    streamed = connection.execute(query.execution_options(yield_per=SETS_AT_A_TIME))
    for rows in streamed.partitions():
        heads = np.array([row[:-1] for row in rows], dtype=np.int64)
        for present, positions, values in parse([row[-1] for row in rows]):
            if set(present) == set(names):
                order = [present.index(name) for name in names]
                yield Candidates(values[:, order], heads[positions, 1:], heads[positions, 0])

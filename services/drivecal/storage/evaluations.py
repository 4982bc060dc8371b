"""Evaluations: the requested cells of campaigns, from plan to answer."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from sqlalchemy import (
    BigInteger,
    Column,
    ColumnElement,
    Connection,
    SmallInteger,
    and_,
    bindparam,
    case,
    cast,
    func,
    select,
    true,
    type_coerce,
    update,
)

from drivecal.contracts.campaign import GenerationCounts
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import INSPECTED, NOT_SIMULATED, Donor, Outcome, OutcomeCosts, Purpose, RequestedCell
from drivecal.storage import leases
from drivecal.storage.engine.bulk import execute_rows, numbers, rows_among
from drivecal.storage.engine.tables import campaigns, evaluations, ratings, runs
from drivecal.storage.references import metrics
from drivecal.storage.references.runs import occupying, values_of

HAS_SEED = evaluations.c.seed > 0
RUN_SEED = case((HAS_SEED, evaluations.c.seed), else_=1)
"""Seed of a cell, from 1: the first one of simulators that are not random is stored as 0."""
AUDITED, SAMPLED = evaluations.c.purpose == Purpose.AUDIT, evaluations.c.purpose == Purpose.SAMPLE


@dataclass(frozen=True, slots=True)
class AnsweredCell:
    """Answer of a pending cell. `failure` is a `Failure` of a run or a `Breakdown` of the attempts. `detail`: the cause of a breakdown in
    words; of an answer after a breakdown, this breakdown before the words (`crash: ...`). `agrees` is true if a sampled
    cell has its predicted score."""

    id: int
    outcome: Outcome
    score: float | None
    rating: float | None
    run_id: int | None
    failure: str | None = None
    milliseconds: float | None = None
    worker: str | None = None
    attempts: int = 0
    agrees: bool | None = None
    detail: str | None = None
    unstarted: int = 0
    """Starts of its lease that did not happen."""


def of_iteration(campaign_sequence: int, stage: StageName, iteration: int) -> tuple[ColumnElement[bool], ...]:
    """Returns the conditions on evaluations that select the cells of an iteration."""
    table = evaluations.c
    return table.campaign_sequence == campaign_sequence, table.stage == stage, table.iteration == iteration


def stored_after(campaign_sequence: int, after: int) -> tuple[ColumnElement[bool], ...]:
    """Returns the conditions on evaluations that select a campaign's cells stored after a cell's id, or all for id 0.

    The sum keeps SQLite from an index by campaign: it would read all the campaign's cells for the newest hundreds.
    """
    mine = evaluations.c.campaign_sequence
    return (mine + 0 == campaign_sequence, evaluations.c.id > after) if after else (mine == campaign_sequence,)


def insert(connection: Connection, campaign_sequence: int, cells: Sequence[RequestedCell]) -> list[int]:
    """Stores a population's cells and returns their ids, in order."""
    if not cells:
        return []
    ids = numbers(connection, evaluations.c.id, len(cells))
    rows = [_row(campaign_sequence, cell, number, ids) for number, cell in zip(ids, cells, strict=True)]
    execute_rows(connection, evaluations.insert(), rows)
    return list(ids)


def answer(connection: Connection, answers: Sequence[AnsweredCell]) -> tuple[int, int, int]:
    """Stores answers; returns the starts of the simulator for their cells, how many of these were lost, and the number of `shared` cells.

    An answered cell keeps its answer, so that late results change nothing, and loses its lease.
    """
    if not answers:
        return 0, 0, 0
    # of an earlier attempt too: another cell's run may be the answer
    ended = leases.end(connection, [answer.id for answer in answers])
    started = {answer.id: ended.get(answer.id, (0, 0))[0] - answer.unstarted for answer in answers}
    statement = (
        update(evaluations)
        .where(evaluations.c.id == bindparam("evaluation"), evaluations.c.outcome.is_(None))
        .values({name: bindparam(f"new_{name}") for name in (*_ANSWER, "runs")})
    )
    rows = [
        {"evaluation": answer.id, "new_runs": started[answer.id]} | {f"new_{name}": getattr(answer, name) for name in _ANSWER}
        for answer in answers
    ]
    execute_rows(connection, statement, rows)
    # a lost start brought no result
    shared = sum(each.outcome is Outcome.SIMULATED and started[each.id] <= ended.get(each.id, (0, 0))[1] for each in answers)
    return sum(started.values()), sum(lost for _, lost in ended.values()), shared


def store(connection: Connection, column: str, values: Mapping[int, Any]) -> None:
    """Stores a value in a column of each of these evaluations, by id."""
    statement = update(evaluations).where(evaluations.c.id == bindparam("evaluation")).values({column: bindparam("value")})
    execute_rows(connection, statement, [{"evaluation": number, "value": value} for number, value in values.items()])


def measured(connection: Connection, cells: Mapping[int, int | None]) -> dict[int, dict[str, float | None]]:
    """Returns the measures of cells by id: of their own runs, or of the runs that answered them. `cells` has the ids of these runs."""
    answering = values_of(connection, [run for run in cells.values() if run is not None])
    known = {cell: answering[run][0] for cell, run in cells.items() if run in answering}
    query = select(evaluations.c.id, evaluations.c.metrics).where(evaluations.c.metrics.is_not(None))
    return known | {row.id: row.metrics for row in rows_among(connection, query, evaluations.c.id, sorted(cells))}


_ANSWER = tuple(field.name for field in fields(AnsweredCell) if field.name not in {"id", "unstarted"})


def simulate(connection: Connection, evaluation_ids: Iterable[int], **more: Any) -> None:
    """Plans a simulation for pending cells, and changes `more` columns of them."""
    statement = update(evaluations).where(evaluations.c.id == bindparam("evaluation"), evaluations.c.outcome.is_(None))
    rows = [{"evaluation": identifier} for identifier in evaluation_ids]
    execute_rows(connection, statement.values(plan=Outcome.SIMULATED, **more), rows)


def occupied(connection: Connection, campaign_sequence: int, after: int) -> tuple[dict[str, tuple[int, int]], int]:
    """Returns, by scenario, how many cells with an id greater than `after` runs answered, and the time (µs) for which these runs occupied
    their workers; and the newest id. Times are whole numbers, so that sums do not depend on their parts."""
    cell, microseconds = evaluations.c, cast(func.round(occupying() * 1000.0), BigInteger)
    query = (
        select(cell.scenario, func.count(), func.sum(microseconds), func.max(cell.id))
        .join(runs, runs.c.id == cell.run_id)
        .where(*stored_after(campaign_sequence, after), runs.c.milliseconds.is_not(None))
    )
    rows = connection.execute(query.group_by(cell.scenario)).all()
    return {name: (cells, int(sum_of)) for name, cells, sum_of, _ in rows}, max((row[3] for row in rows), default=after)


def own_answers(
    connection: Connection,
    campaign_sequence: int,
    scenario: str,
    setup_id: int,
    wanted: Sequence[Any],
    before: int | None = None,
    *,
    by_key: bool = False,
) -> dict[Any, Donor]:
    """Returns the campaign's own first answers by parameter set.

    Args:
        connection: where to read.
        campaign_sequence: number of the campaign.
        scenario: the scenario of the cells.
        setup_id: number of the setup in the database.
        wanted: numbers of parameter sets.
        before: answers of the calibration from this iteration on are not seen; None to see all.
        by_key: `wanted` has reference keys under the campaign's influence map instead, and so has the result.
    """
    table = evaluations.c
    column: Column[Any] = table.reference_key if by_key else table.parameter_set_id
    place = (type_coerce(table.stage, SmallInteger), table.iteration, table.individual)  # by number, stages sort as they run
    query = select(column, *place, table.id, table.run_id, table.score, table.rating, table.failure).where(
        table.campaign_sequence == campaign_sequence,
        table.scenario == scenario,
        table.setup_id == setup_id,  # studies drive the same sets in other vehicles
        table.plan == Outcome.SIMULATED,
        table.outcome == Outcome.SIMULATED,
    )
    if before is not None:
        query = query.where((table.stage != StageName.CALIBRATION) | (table.iteration < before))
    first: dict[Any, tuple[tuple[int, int, int], Donor]] = {}
    for value, stage, iteration, individual, *donor in rows_among(connection, query, column, wanted):
        at = (stage, iteration, individual)
        if value not in first or at < first[value][0]:
            first[value] = at, Donor(*donor)
    return {value: donor for value, (_, donor) in first.items()}


def released_before(
    connection: Connection, place: tuple[int, int, str, int], evaluator: str, parameter_set_ids: Sequence[int]
) -> dict[int, Donor]:
    """Returns the references that answered parameter sets in campaigns of the same `likeness` that had ended when this one began, by
    parameter set.

    Args:
        connection: where to read.
        place: number of the campaign, iteration, scenario, and number of the setup in the database.
        evaluator: the evaluator whose ratings are wanted.
        parameter_set_ids: numbers of the sets.
    """
    campaign_sequence, iteration, scenario, setup_id = place
    cell, here = evaluations.c, campaigns.alias()
    is_alike = (here.c.likeness == campaigns.c.likeness) & (campaigns.c.ended_at <= here.c.started_at)
    alike = select(campaigns.c.sequence).join(here, is_alike).where(here.c.sequence == campaign_sequence)
    query = (
        select(cell.parameter_set_id, cell.reference, cell.run_id, ratings.c.score, ratings.c.rating, cell.failure)
        .join(ratings, (ratings.c.run_id == cell.run_id) & (ratings.c.evaluator == evaluator))
        .where(cell.campaign_sequence.in_(alike), cell.scenario == scenario, cell.setup_id == setup_id)
        .where(cell.iteration == iteration, cell.outcome == Outcome.REUSED, cell.reference.is_not(None))
        .order_by(cell.id.desc())
    )
    rows = rows_among(connection, query, cell.parameter_set_id, [int(number) for number in parameter_set_ids])
    return {number: Donor(*donor) for number, *donor in rows}


_PREDICTION = ("lot", "confidence", "predicted_score", "predicted_rating")


def _row(campaign_sequence: int, cell: RequestedCell, number: int, together: Sequence[int]) -> dict[str, Any]:
    """`together`: the numbers of the cells that are inserted with it."""
    leader = None if cell.leader is None else together[cell.leader]
    answered = cell.donor if cell.answered_at_once else None
    as_it_is = ("stage", "scenario", "setup_id", "parameter_set_id", "reference_key", "plan", "purpose", *_PREDICTION)
    return {name: getattr(cell, name) for name in as_it_is} | {
        "id": number,
        "campaign_sequence": campaign_sequence,
        "iteration": int(cell.iteration),
        "individual": int(cell.individual),
        "seed": cell.seed if cell.has_seed else 0,
        "outcome": None if answered is None else cell.plan,
        **{name: getattr(answered, name, None) for name in ("score", "rating", "failure")},
        "run_id": None if answered is None else answered.run,
        "reference": leader if leader is not None or cell.donor is None else cell.donor.evaluation,
        "attempts": 0,
        "runs": 0,
    }


@dataclass(frozen=True, slots=True)
class FailedCells:
    """Cells of a campaign that failed with the same words, in one scenario. `example`: the first one's id."""

    outcome: Outcome
    failure: str
    detail: str | None
    scenario: str
    cells: int
    example: int


def failed_cells(connection: Connection, campaign_sequence: int, most: int) -> list[FailedCells]:
    """Returns at most `most` groups of cells, large ones first: without a result, with a failure of the system under test, or with a result
    after a breakdown, which is the `detail` then."""
    cell, count = evaluations.c, func.count()
    group = (cell.outcome, cell.failure, cell.detail, cell.scenario)
    query = (
        select(*group, count, func.min(cell.id))
        .where(cell.campaign_sequence == campaign_sequence, cell.outcome.is_not(None))
        .where(cell.failure.is_not(None) | cell.detail.is_not(None))
        .group_by(*group)
        .order_by(count.desc(), func.min(cell.id))
    )
    return [FailedCells(Outcome(row[0]), *row[1:]) for row in connection.execute(query.limit(most))]


def first_simulated(connection: Connection, campaign_sequence: int, stage: StageName, most: int) -> list[Outcome | None]:
    """Returns the outcomes of a stage's first cells that are to be simulated, None while they are pending: ordered by iteration,
    individual and scenario, so that the first ones are in all scenarios."""
    cell = evaluations.c
    query = (
        select(cell.outcome)
        .where(cell.campaign_sequence == campaign_sequence, cell.stage == stage, cell.plan == Outcome.SIMULATED)
        .order_by(cell.iteration, cell.individual, cell.scenario)
    )
    return [None if outcome is None else Outcome(outcome) for outcome in connection.scalars(query.limit(most))]


@dataclass(frozen=True, slots=True)
class ScoredRun:
    """A run that answered `cells` of a campaign with a given score. `example`: the first one's id."""

    scenario: str
    metrics: Mapping[str, float | None]
    cells: int
    example: int


def scored(connection: Connection, campaign_sequence: int, score: float | None, most: int) -> list[ScoredRun]:
    """Returns at most `most` runs without a failure that answered cells, in the order of the cells; `score`: cells with this one alone."""
    cell = evaluations.c
    query = (
        select(cell.scenario, runs.c.metrics, func.count(), func.min(cell.id))
        .join(runs, runs.c.id == cell.run_id)
        .where(cell.campaign_sequence == campaign_sequence, cell.failure.is_(None))
        .where(true() if score is None else cell.score == score)
        .group_by(cell.scenario, runs.c.id)
        .order_by(func.min(cell.id))
    )
    read = metrics.reader(connection)
    return [ScoredRun(row[0], read(row[1]), *row[2:]) for row in connection.execute(query.limit(most))]


def cells_from(connection: Connection, campaign_sequence: int, stage: StageName, first: int) -> tuple[int, int]:
    """Returns the last iteration of a stage, and the number of cells in `first` and later iterations; `first` - 1 and 0 without cells."""
    table = evaluations.c
    query = select(func.max(table.iteration), func.count()).where(
        table.campaign_sequence == campaign_sequence, table.stage == stage, table.iteration >= first
    )
    last, cells = connection.execute(query).one()
    return first - 1 if last is None else int(last), int(cells)


def places(connection: Connection, campaign_sequence: int, stage: StageName) -> list[tuple[int, int, str, int]]:
    """Returns iteration, individual, scenario and seed of a stage's cells, in the order of requests."""
    table = evaluations.c
    query = select(table.iteration, table.individual, table.scenario, RUN_SEED).where(
        table.campaign_sequence == campaign_sequence, table.stage == stage
    )
    return [(*row,) for row in connection.execute(query.order_by(table.id))]


def counts(connection: Connection, campaign_sequence: int, stage: StageName, iteration: int) -> GenerationCounts:
    """Returns the answered cells of an iteration by outcome, and its inspected cells with a simulation."""
    table = evaluations.c
    group = table.outcome, table.purpose
    query = select(*group, func.count().label("cells")).where(*of_iteration(campaign_sequence, stage, iteration))
    counted: Counter[str] = Counter()
    for row in connection.execute(query.where(table.outcome.is_not(None)).group_by(*group)):
        counted.update({"requested": row.cells, row.outcome: row.cells})
        if row.outcome == Outcome.SIMULATED and row.purpose in INSPECTED:
            counted[INSPECTED[row.purpose]] += row.cells
    return GenerationCounts(**counted)


def confirmed(connection: Connection, campaign_sequence: int) -> dict[str, dict[Outcome, int]]:
    """Returns the number of cells that were simulated to confirm the best set, by scenario and by what had answered them before."""
    late, first = evaluations.alias("late"), evaluations.alias("first")
    same = (late.c.campaign_sequence, late.c.stage, late.c.scenario, late.c.parameter_set_id)
    earlier = (first.c.campaign_sequence, first.c.stage, first.c.scenario, first.c.parameter_set_id)
    answered = (
        select(late.c.scenario, func.min(first.c.outcome).label("outcome"))
        .join(first, and_(*(mine == theirs for mine, theirs in zip(same, earlier, strict=True))))
        .where(
            late.c.campaign_sequence == campaign_sequence,
            late.c.purpose == Purpose.CONFIRMATION,
            first.c.outcome.in_(NOT_SIMULATED),
        )
        .group_by(late.c.id, late.c.scenario)
        .subquery()
    )
    counted: dict[str, dict[Outcome, int]] = {}
    for row in connection.execute(select(*answered.c, func.count().label("cells")).group_by(*answered.c)):
        counted.setdefault(row.scenario, {})[Outcome(row.outcome)] = row.cells
    return counted


def are_seeded(connection: Connection, campaign_sequence: int) -> bool:
    """Returns whether a campaign's simulator is random: its cells are stored with seeds."""
    query = select(HAS_SEED).where(evaluations.c.campaign_sequence == campaign_sequence).order_by(evaluations.c.id).limit(1)
    return bool(connection.execute(query).scalar())


def runs_by_purpose(connection: Connection, campaign_sequence: int) -> dict[str, int]:
    """Returns the starts of the simulator by what they were for, frequent ones first. All but the first one of each cell are `further`:
    they check that equal runs are equal, or follow a breakdown or a lost worker. The sum is that of `CellCounts.runs` over all stages."""
    cell, counted = evaluations.c, Counter[str]()
    query = select(cell.purpose, func.count(), func.sum(cell.runs)).where(cell.campaign_sequence == campaign_sequence)
    for purpose, cells, starts in connection.execute(query.where(cell.runs > 0).group_by(cell.purpose)):
        counted.update({purpose: cells, "further": starts - cells})
    return {name: runs for name, runs in counted.most_common() if runs}


def costs_by_outcome(connection: Connection, campaign_sequence: int) -> list[OutcomeCosts]:
    """Returns the costs of the answered cells of a campaign, ordered by stage and scenario."""
    group = (evaluations.c.stage, evaluations.c.scenario, evaluations.c.outcome, AUDITED.label("audited"))
    query = (
        select(
            *group,
            func.count(),
            func.coalesce(func.sum(evaluations.c.milliseconds), 0.0),
            func.count(runs.c.id),
            func.coalesce(func.sum(runs.c.milliseconds), 0.0),
            func.coalesce(func.sum(case((runs.c.evaluation_id == evaluations.c.id, occupying()))), 0.0),
            func.coalesce(func.sum(occupying()), 0.0),
        )
        .select_from(evaluations.outerjoin(runs, runs.c.id == evaluations.c.run_id))
        .where(evaluations.c.campaign_sequence == campaign_sequence, evaluations.c.outcome.is_not(None))
        .group_by(*group)
        .order_by(*group)
    )
    return [
        OutcomeCosts(
            *(stage, scenario, Outcome(outcome), audited, cells, own / 1000, simulated, answered / 1000),
            *(occupied / 1000, occupying / 1000),
        )
        for stage, scenario, outcome, audited, cells, own, simulated, answered, occupied, occupying in connection.execute(query)
    ]

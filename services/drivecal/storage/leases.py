"""Leases: the evaluations at workers, their dispatcher's term, and their breakdowns.

Before a cell is sent to a worker, it is leased (`take`); its result counts only while that lease is the current one (`current`). So a cell
may be simulated more than once, after a crash of whatever process, but has one effect. Leases belong to a dispatcher's term
(`processes`): they end with it, so that the next dispatcher need not wait for any of them. The breakdowns do not end: a cell that brings
its workers down must not get three new attempts from every dispatcher.

A lease also counts the starts of the simulator: all before the cell is sent, less the starts that did not happen when it comes back, or
when its worker was killed and had noted its starts. So no start is missing after a crash: a cell whose starts are unknown counts as
started, and as lost. Lost starts are no part of a budget, so that a campaign asks for the same cells whatever was killed.

A lease has no row of its own before it was taken once, and none any more when the cell has its answer.
"""

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence

from sqlalchemy import ColumnElement, Connection, bindparam, case, delete, func, literal, select, update

from drivecal.domain.campaigns import StageName
from drivecal.storage.engine.bulk import among, insert, rows_among
from drivecal.storage.engine.tables import evaluations, leases
from drivecal.storage.processes import term_in_office


def take(connection: Connection, breakdowns: Mapping[int, int], twice: Collection[int] = ()) -> dict[int, int]:
    """Leases evaluations; returns the numbers of the granted leases by id. `breakdowns` has the number of breakdowns of each
    evaluation by id. Evaluations in `twice` are simulated twice.

    Grants no lease for answered evaluations, nor while a lease of this term is not given back. On PostgreSQL, it also skips
    cells that another transaction is leasing, without waiting.
    """
    term = term_in_office(connection)
    by_count: dict[tuple[int, int], list[int]] = defaultdict(list)
    for evaluation, count in sorted(breakdowns.items()):
        by_count[count, 1 + (evaluation in twice)].append(evaluation)
    granted: dict[int, int] = {}
    for (count, starts), wanted in by_count.items():
        numbers = literal(1), literal(0), literal(starts), literal(0), literal(count), literal(term), literal(True)
        lease = select(evaluations.c.id, *numbers).where(evaluations.c.outcome.is_(None))
        for condition in among(connection, evaluations.c.id, wanted):
            unanswered = lease.where(condition).with_for_update(skip_locked=True)
            columns = ["evaluation_id", "number", "starts", "running", "lost", *_RENEWED]
            new = insert(connection, leases).from_select(columns, unanswered)
            statement = new.on_conflict_do_update(
                index_elements=["evaluation_id"],
                set_={"number": leases.c.number + 1, "lost": leases.c.lost + leases.c.running, "running": starts}
                | {name: new.excluded[name] for name in _RENEWED},
                where=(leases.c.term != term) | ~leases.c.at_worker,
            )
            rows = connection.execute(statement.returning(leases.c.evaluation_id, leases.c.number))
            granted |= {row.evaluation_id: row.number for row in rows}
    return granted


_RENEWED = ("attempts", "term", "at_worker")


def give_back(connection: Connection, breakdowns: Mapping[int, int], unstarted: Mapping[int, int] | None = None) -> None:
    """Ends leases of this term whose cells have no answer, and notes how often each broke down so far, by id; `unstarted`: how many of
    their starts did not happen. The others are lost if there is no breakdown that is new."""
    if not breakdowns:
        return
    begun = case((leases.c.running == 0, 0), else_=leases.c.running - bindparam("unstarted"))  # once
    broke_down = leases.c.attempts < bindparam("breakdowns")
    statement = (
        update(leases)
        .where(leases.c.evaluation_id == bindparam("evaluation"), leases.c.term == term_in_office(connection))
        .values(
            attempts=bindparam("breakdowns"),
            starts=leases.c.starts + case((broke_down, begun), else_=0),
            lost=leases.c.lost + case((broke_down, 0), else_=begun),
            running=0,
            at_worker=False,
        )
    )
    fewer = unstarted or {}
    rows = [
        {"evaluation": evaluation, "breakdowns": count, "unstarted": fewer.get(evaluation, 0)}
        for evaluation, count in sorted(breakdowns.items())
    ]
    connection.execute(statement, rows)


def current(connection: Connection, numbers: Mapping[int, int]) -> set[int]:
    """Returns the evaluations whose lease number, by id, is current. Other results are late: another process has, or had, the cell."""
    query = select(leases.c.evaluation_id, leases.c.number).where(leases.c.term == term_in_office(connection)).with_for_update()
    rows = rows_among(connection, query, leases.c.evaluation_id, list(numbers))
    return {evaluation for evaluation, number in rows if numbers[evaluation] == number}


def end(connection: Connection, evaluation_ids: Sequence[int]) -> dict[int, tuple[int, int]]:
    """Ends the leases of answered evaluations; returns the starts of each by id, and how many of these were lost. The caller stores the
    answers in the same transaction."""
    columns = leases.c.evaluation_id, _STARTS, _lost(term_in_office(connection))
    return {
        evaluation: (started, lost)
        for condition in among(connection, leases.c.evaluation_id, list(evaluation_ids))
        for evaluation, started, lost in connection.execute(delete(leases).where(condition).returning(*columns))
    }


_STARTS = leases.c.starts + leases.c.running + leases.c.lost


def _lost(term: int) -> ColumnElement[int]:
    """Returns the starts that were lost, those included that run for a dispatcher of another term: nothing waits for them."""
    return leases.c.lost + case((leases.c.term != term, leases.c.running), else_=0)


def starts(connection: Connection, evaluation_ids: Sequence[int]) -> dict[int, int]:
    """Returns the broken starts of evaluations without an answer, by id."""
    query = select(leases.c.evaluation_id, leases.c.starts)
    return dict(rows_among(connection, query, leases.c.evaluation_id, list(evaluation_ids)))


def breakdowns(connection: Connection, evaluation_ids: Sequence[int]) -> dict[int, int]:
    """Returns the breakdowns of evaluations by id, for evaluations that broke down."""
    query = select(leases.c.evaluation_id, leases.c.attempts).where(leases.c.attempts > 0)
    return dict(rows_among(connection, query, leases.c.evaluation_id, list(evaluation_ids)))


def forget(connection: Connection, campaign_sequence: int) -> dict[StageName, tuple[int, int]]:
    """Removes the leases of an ended campaign, whose other cells get no answer, and notes the starts of each; returns their starts by
    stage, and how many were lost."""
    pending = (evaluations.c.campaign_sequence == campaign_sequence) & evaluations.c.outcome.is_(None)
    sums = func.sum(_STARTS), func.sum(_lost(term_in_office(connection)))
    total = select(evaluations.c.stage, *sums).join(leases).where(pending).group_by(evaluations.c.stage)
    starts_by_stage = {StageName(stage): (int(count), int(lost)) for stage, count, lost in connection.execute(total)}
    own = select(func.coalesce(func.sum(_STARTS), 0)).where(leases.c.evaluation_id == evaluations.c.id)
    connection.execute(update(evaluations).where(pending).values(runs=own.scalar_subquery()))
    connection.execute(delete(leases).where(leases.c.evaluation_id.in_(select(evaluations.c.id).where(pending))))
    return starts_by_stage

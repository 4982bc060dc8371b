"""Withdrawal of certified results after a simulation contradicted a certificate of their setup.

Workers answer the cells of a setup from the same recorded decisions. If one certificate is wrong, its siblings may be wrong too: all
results of the setup that no simulation gave. They stay as answers of their cells, marked, and answer no other cell from then on. Rankings
take them for copies (`storage.results`): a simulation of the very cell takes their place, and confirms the best set if it has one.
"""

from collections.abc import Collection

from sqlalchemy import ColumnElement, Connection, FromClause, and_, delete, select, update

from drivecal.domain.evaluations import Outcome
from drivecal.storage.engine.bulk import among
from drivecal.storage.engine.tables import evaluations, ratings, reference_keys, runs

WITHDRAWN = "withdrawn: a simulation contradicted a certificate of the same setup"
"""Detail of a withdrawn answer."""


def is_withdrawn(cells: FromClause) -> ColumnElement[bool]:
    """Whether the certificate of an answer among `cells`, evaluations or an alias of them, was withdrawn: other certified and repeated ones
    keep their run as long as they are stored."""
    return cells.c.outcome.in_((Outcome.CERTIFIED, Outcome.REPEATED)) & cells.c.run_id.is_(None)


def is_copied(cells: FromClause) -> ColumnElement[bool]:
    """Whether no run of the very cell is known of an answer among `cells`: a reused, predicted or withdrawn one."""
    return cells.c.outcome.in_((Outcome.REUSED, Outcome.PREDICTED)) | is_withdrawn(cells)


def withdraw_certified(connection: Connection, setup_ids: Collection[int]) -> int:
    """Removes the certified results of setups from the reference table, and marks all answers that rest on them, of any campaign.

    Simulated results stay. A withdrawn answer keeps its score and has no run. Returns the number of withdrawn answers.
    """
    of_setup = runs.c.setup_id.in_(sorted(setup_ids))
    origin = evaluations.alias("origin")
    certified = (
        select(runs.c.id)
        .join(origin, origin.c.id == runs.c.evaluation_id)
        .where(of_setup, origin.c.outcome == Outcome.CERTIFIED)
    )
    ids = list(connection.scalars(certified))
    # by the runs of the setups and their index, for only a whole read would find cells by their setup
    answered = evaluations.c.run_id.in_(select(runs.c.id).where(of_setup))
    pending = evaluations.c.outcome.is_(None) & evaluations.c.setup_id.in_(sorted(setup_ids))
    for cells in (answered, pending):
        reused = and_(cells, evaluations.c.plan == Outcome.REUSED, evaluations.c.proven_by.is_not(None))
        connection.execute(update(evaluations).where(reused).values(proven_by=None))
    own = and_(answered, evaluations.c.outcome == Outcome.CERTIFIED)
    withdrawn = set(connection.scalars(select(evaluations.c.id).where(own)))
    for chunk in among(connection, evaluations.c.run_id, ids):
        withdrawn |= set(connection.scalars(select(evaluations.c.id).where(chunk)))
    for chunk in among(connection, evaluations.c.id, sorted(withdrawn)):
        connection.execute(update(evaluations).where(chunk).values(run_id=None, detail=WITHDRAWN))
    for table in (reference_keys, ratings):
        for chunk in among(connection, table.c.run_id, ids):
            connection.execute(delete(table).where(chunk))
    for chunk in among(connection, runs.c.id, ids):
        connection.execute(delete(runs).where(chunk))
    return len(withdrawn)

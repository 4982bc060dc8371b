"""Answers of the cells that outside optimizers propose, by arrival."""

from sqlalchemy import Connection, func, select

from drivecal.contracts.outside.sets import CellAnswered
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Outcome
from drivecal.domain.parameters import ParameterSet
from drivecal.storage import evaluations as stored_evaluations
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.tables import evaluations, outside_sets, parameter_sets, runs
from drivecal.storage.references import metrics


def number(connection: Connection, campaign_sequence: int, iteration: int) -> None:
    """Numbers the new answers, by arrival. Earlier iterations have theirs."""
    cell = evaluations.c
    mine = cell.campaign_sequence == campaign_sequence
    searched = cell.stage == StageName.CALIBRATION, cell.iteration >= iteration
    new = select(cell.id).where(mine, *searched, cell.outcome.is_not(None), cell.answered.is_(None))
    ids = list(connection.scalars(new.order_by(cell.id)))
    if ids:
        newest = connection.scalar(select(func.max(cell.answered)).where(mine, cell.answered.is_not(None))) or 0
        stored_evaluations.store(connection, "answered", {number: place for place, number in enumerate(ids, newest + 1)})


def after(connection: Connection, campaign: StoredCampaign, last: int, limit: int) -> list[CellAnswered]:
    """Returns the answers of a campaign after a number, by arrival, at most `limit`."""
    cell, proposed = evaluations.c, outside_sets.c
    own = (
        (proposed.campaign_sequence == cell.campaign_sequence)
        & (proposed.iteration == cell.iteration)
        & (proposed.individual == cell.individual)
    )
    names = ("scenario", "seed", "outcome", "score", "rating", "reference", "failure", "detail")
    labelled = {"number": cell.answered, "set": proposed.number, "evaluation": cell.id, "own": cell.metrics}
    columns = *(column.label(name) for name, column in labelled.items()), *(cell[name] for name in names)
    query = (
        select(*columns, proposed.key, parameter_sets.c.parameter_values.label("parameters"), runs.c.metrics)
        .select_from(
            evaluations.join(outside_sets, own)
            .join(parameter_sets, parameter_sets.c.id == cell.parameter_set_id)
            .outerjoin(runs, runs.c.id == cell.run_id)
        )
        .where(cell.campaign_sequence == campaign.sequence, cell.answered > last, cell.answered.is_not(None))
        .order_by(cell.answered)
        .limit(limit)
    )
    read = metrics.reader(connection)
    wrong = {Outcome.FAILED: None, Outcome.REUSED: campaign.spec["reduction"]["max_error"]}
    return [
        CellAnswered.of(
            row,
            parameters=ParameterSet.from_json(row.parameters).floats,
            metrics=row.own if row.own is not None or row.metrics is None else dict(read(row.metrics)),
            wrong_at_most=wrong.get(row.outcome, 0.0),
        )
        for row in connection.execute(query)
    ]

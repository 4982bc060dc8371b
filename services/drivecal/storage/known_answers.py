"""Answers of a campaign from which its predictors learn."""

from collections.abc import Collection
from dataclasses import dataclass

from sqlalchemy import Connection, case, select

from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Outcome
from drivecal.domain.parameters import ParameterSet
from drivecal.storage.engine.tables import evaluations, lots, parameter_sets
from drivecal.storage.evaluations import stored_after
from drivecal.storage.lots import LotVerdict
from drivecal.storage.results import parsed


@dataclass(frozen=True, slots=True)
class KnownAnswer:
    """A simulated or certified answer that a predictor may learn from. `predicted_score` and `confidence`: of a cell that was predicted
    first; `stands_for`: the number of predictions that a sampled cell of a released lot represents, else 1."""

    id: int
    scenario: str
    stage: StageName
    iteration: int
    individual: int
    parameters: ParameterSet
    score: float
    rating: float
    predicted_score: float | None
    confidence: float | None
    stands_for: float


def known(
    connection: Connection, campaign_sequence: int, setup_ids: Collection[int], after: int
) -> tuple[list[KnownAnswer], int]:
    """Returns the simulated and certified answers of a campaign in some setups, of cells stored `after` a cell's id, in the order of their
    request, and the id of the newest. Call it while no cell waits for its answer."""
    cell = evaluations.c
    weight = case(((lots.c.verdict == LotVerdict.RELEASED) & cell.sampled, lots.c.size * 1.0 / lots.c.sample), else_=1.0)
    query = (
        select(
            cell.id,
            cell.scenario,
            cell.stage,
            cell.iteration,
            cell.individual,
            parameter_sets.c.parameter_values,
            cell.score,
            cell.rating,
            cell.predicted_score,
            cell.confidence,
            weight,
        )
        .join(parameter_sets)
        .outerjoin(lots, lots.c.id == cell.lot)
        .where(
            *stored_after(campaign_sequence, after),
            cell.setup_id.in_(list(setup_ids)),
            cell.outcome.in_((Outcome.SIMULATED, Outcome.CERTIFIED)),
            cell.run_id.is_not(None),  # not withdrawn
        )
        .order_by(cell.stage, cell.iteration, cell.individual, cell.scenario)
    )
    rows = connection.execute(query).all()
    answers = [KnownAnswer(*row[:5], parsed(row.parameter_values), *row[6:]) for row in rows]
    return answers, max((row.id for row in rows), default=after)

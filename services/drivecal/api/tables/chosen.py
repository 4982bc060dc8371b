"""A set of a campaign beside its baseline, for the light of this very set."""

from drivecal.analysis.chosen import BesideBaseline, Chosen
from drivecal.analysis.goals import Objective
from drivecal.analysis.solutions import EvaluatedSet
from drivecal.campaigns.results.front import CampaignFront
from drivecal.storage import results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database


def set_at(
    database: Database,
    stored: StoredCampaign,
    front: CampaignFront,
    place: tuple[int, int],
    baseline: EvaluatedSet | None,
) -> Chosen:
    """Returns the set at a `place` of the search, its iteration and individual, with its objectives beside those of the `baseline`. Raises
    NotFoundError if the search has no such place."""
    scenario = next(iter(front.goals.objectives[0].shares))
    with database.read() as connection:
        cell = results.by_id(connection, results.number_at(connection, stored.sequence, *place, scenario))
    parameters = cell.parameters.floats
    is_best = stored.best is not None and stored.best.parameters == parameters
    judged = next((each for each in front.ranked if each.parameter_set == cell.parameter_set_id), None)
    if judged is None or judged.judgement is None:
        return Chosen(parameters, is_judged=False, is_best=is_best)
    compared: list[BesideBaseline] = []
    if baseline and baseline.judgement:
        amounts = zip(front.goals.objectives, judged.judgement.amounts, baseline.judgement.amounts, strict=True)
        compared = [
            BesideBaseline(goal.name, value, before, goal.sign, goal.unit, _tolerance(goal, len(front.goals.objectives)))
            for goal, value, before in amounts
        ]
    return Chosen(
        parameters=parameters,
        compared=compared,
        copied=judged.reused,
        violation=judged.shares_violated,
        baseline_violation=0.0 if baseline is None else baseline.shares_violated,
        is_best=is_best,
    )


def _tolerance(goal: Objective, objectives: int) -> float:
    """Returns the differences that do not count: the objective's own; if it is the only one, else those of its score's scale."""
    if goal.tolerance or objectives > 1 or goal.value.scale is None:
        return goal.tolerance
    return goal.value.scale.tolerance

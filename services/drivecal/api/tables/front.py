"""Rows and summary of a campaign's front."""

from collections.abc import Sequence

from sqlalchemy import Connection

from drivecal.analysis.goals import Bound, Goal, Objective
from drivecal.analysis.optima import distances
from drivecal.analysis.robustness import key_of
from drivecal.analysis.solutions import EvaluatedSet, FrontMember
from drivecal.api.tables.ranking import given_weights
from drivecal.campaigns.resolve.resolved_spec import ResolvedSpec
from drivecal.campaigns.results.front import CampaignFront, answers_of
from drivecal.campaigns.results.optima import unit_cube
from drivecal.contracts.results import FrontBaseline, FrontGrowth, FrontObjective, FrontSummary, TradeOff, ValuePair
from drivecal.contracts.tables import FrontRow, JudgedSet
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.scales import Direction, plain, unit_text
from drivecal.storage import studies
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import parameter_sets


def weighted(front: CampaignFront, weights: str | None) -> tuple[CampaignFront, Sequence[float | None]]:
    """Returns a front by rank and the weighted sums. Raises InvalidInputError for unusable `weights` (`comfort=2,gap=1`)."""
    if weights is None:
        return front, [None] * len(front.members)
    names = [goal.name for goal in front.goals.objectives]
    ordered, sums = front.by_weights(given_weights(weights, names, "objective"))
    return ordered, sums.tolist()


def front_table(
    database: Database, campaign: StoredCampaign, front: CampaignFront, weights: str | None = None
) -> list[FrontRow]:
    """Returns the rows of a front. Raises InvalidInputError for unusable `weights`."""
    names = [goal.name for goal in front.goals.objectives]
    front, worths = weighted(front, weights)
    with database.read() as connection:
        sets = parameter_sets.load(connection, [member.solution.parameter_set for member in front.members])
        degrees = _degrees(connection, campaign)
    winning, answers = front.winning, answers_of(database, campaign, [member.solution for member in front.members])
    rows = []
    for place, member in enumerate(front.members):
        solution, parameters = member.solution, sets[member.solution.parameter_set].floats
        amounts = () if solution.judgement is None else solution.judgement.amounts
        rows.append(
            FrontRow(
                rank=place + 1,
                objectives=dict(zip(names, amounts, strict=True)),
                weighted=worths[place],
                violation=solution.violation,
                constraints=front.goals.named_bounds(solution.judgement),
                knee=front.knee == place,
                best_in=[name for name, best in zip(names, front.extremes, strict=True) if best == place],
                wins=None if winning is None else winning[place].share,
                weights=None if winning is None else [list(corner) for corner in winning[place].corners],
                alternatives=member.alternatives,
                degree=degrees.get(key_of(parameters)),
                scores={name: plain(score) for name, score in solution.scores.items()},
                values=front.goals.named_values(member.cells),
                reused=list(solution.reused),
                answers=answers[solution.parameter_set],
                parameters=parameters,
                iteration=solution.iteration,
                individual=solution.individual,
            )
        )
    return rows


def judged_sets(front: CampaignFront) -> list[JudgedSet]:
    """Returns every evaluated set by its objectives, in the order of the ranking."""
    names = [goal.name for goal in front.goals.objectives]
    return [
        JudgedSet(
            objectives=dict(zip(names, solution.judgement.amounts, strict=True)),
            violation=solution.violation,
            on_front=solution.parameter_set in front.ranks,
            iteration=solution.iteration,
            individual=solution.individual,
        )
        for solution in front.ranked
        if solution.judgement is not None
    ]


def summary(front: CampaignFront, baseline: EvaluatedSet | None = None) -> FrontSummary:
    """Returns the summary of a front in its order."""
    growth = [FrontGrowth(iteration=number, hypervolume=volume, size=size) for number, volume, size in front.hypervolumes()]
    listed = [
        _objective(goal, column, front, reference)
        for column, (goal, reference) in enumerate(zip(front.goals.objectives, front.reference, strict=True))
    ]
    return FrontSummary(
        objectives=listed,
        constraints=[bound_text(bound) for bound in front.goals.bounds],
        evaluated=len(front.ranked),
        feasible=sum(solution.violation == 0 for solution in front.ranked),
        size=len(front.members),
        copied=sum(bool(member.solution.reused) for member in front.members),
        knee=None if front.knee is None else front.knee + 1,
        extremes={goal.name: best + 1 for goal, best in zip(front.goals.objectives, front.extremes, strict=False)},
        baseline=None if baseline is None else _baseline(front, baseline),
        hypervolume=growth[-1].hypervolume if growth else None,
        growth=growth,
    )


def _baseline(front: CampaignFront, baseline: EvaluatedSet) -> FrontBaseline | None:
    if baseline.judgement is None:
        return None
    names = [goal.name for goal in front.goals.objectives]
    return FrontBaseline(
        objectives=dict(zip(names, baseline.judgement.amounts, strict=True)),
        violation=baseline.violation,
        constraints=front.goals.named_bounds(baseline.judgement),
        rank=front.ranks.get(baseline.parameter_set),
    )


def trade_off(database: Database, front: CampaignFront, resolved: ResolvedSpec, first: int, second: int) -> TradeOff:
    """Returns how two sets of a front differ. Raises InvalidInputError for ranks that it does not have."""
    members = [_of_rank(front, rank, field) for field, rank in (("first", first), ("second", second))]
    solutions = [member.solution for member in members]
    with database.read() as connection:
        stored = parameter_sets.load(connection, [solution.parameter_set for solution in solutions])
    before, after = (stored[solution.parameter_set] for solution in solutions)
    amounts = [() if solution.judgement is None else solution.judgement.amounts for solution in solutions]
    places = unit_cube(resolved.space, [before, after])
    goals = front.goals.objectives
    compared = [
        ValuePair(name=goal.name, first=own, second=other, gain=goal.sign * (other - own))
        for goal, own, other in zip(goals, *amounts, strict=True)
    ]
    bounded = [front.goals.named_bounds(solution.judgement) for solution in solutions]
    values = [front.goals.named_values(member.cells) for member in members]
    sign = resolved.scale.sign
    return TradeOff(
        first=first,
        second=second,
        objectives=compared,
        constraints=[ValuePair(name=name, first=amount, second=bounded[1][name]) for name, amount in bounded[0].items()],
        scores=[
            ValuePair(name=name, first=plain(score), second=plain(other), gain=sign * (other - score))
            for name, score in solutions[0].scores.items()
            for other in [solutions[1].scores[name]]
        ],
        values=[ValuePair(name=name, first=value, second=values[1].get(name)) for name, value in values[0].items()],
        parameters=[
            ValuePair(name=name, first=value, second=after.floats[name])
            for name, value in before.floats.items()
            if value != after.floats[name]
        ],
        distance=float(distances(places[:1], places[1:])[0, 0]),
        text=[_text(goal, each) for goal, each in zip(goals, compared, strict=True)],
    )


def _of_rank(front: CampaignFront, rank: int, field: str) -> FrontMember:
    if not 1 <= rank <= len(front.members):
        message = f"the front has no set of rank {rank}"
        raise InvalidInputError(Problem(field, message, f"give 1 to {len(front.members)}"))
    return front.members[rank - 1]


def _text(goal: Objective, difference: ValuePair) -> str:
    gain = float(difference.gain or 0.0)
    equal = f"stays within its tolerance of {goal.tolerance:g}" if goal.tolerance else "stays as it is"
    is_equal = abs(gain) <= goal.slack(*(each for each in (difference.first, difference.second) if isinstance(each, float)))
    values = f"{difference.first:.6g} to {difference.second:.6g}{unit_text(goal.unit)}"
    return f"{goal.name} {equal if is_equal else 'gets better' if gain > 0 else 'gets worse'}: {values}"


def _objective(goal: Objective, column: int, front: CampaignFront, reference: float) -> FrontObjective:
    amounts = [member.solution.judgement.amounts[column] for member in front.members if member.solution.judgement is not None]
    return FrontObjective(
        name=goal.name,
        unit=goal.unit,
        direction=(Direction.MAXIMISE if goal.sign > 0 else Direction.MINIMISE).value,
        aggregate=_aggregate_text(goal),
        scenarios=dict(goal.shares),
        tolerance=goal.tolerance,
        reference=reference,
        best=max(amounts, key=lambda amount: goal.sign * amount, default=None),
        worst=min(amounts, key=lambda amount: goal.sign * amount, default=None),
    )


def _aggregate_text(goal: Goal) -> str:
    return f"quantile {goal.aggregate.level:g}" if goal.aggregate.kind == "quantile" else goal.aggregate.kind


def bound_text(bound: Bound) -> str:
    """Returns a constraint in words."""
    sign = ">=" if bound.sign > 0 else "<="
    return f"{_aggregate_text(bound)} of {bound.name} {sign} {bound.limit:g} ({', '.join(bound.shares)})"


def _degrees(connection: Connection, campaign: StoredCampaign) -> dict[tuple[tuple[str, float | str], ...], int]:
    """Degrees of robustness by parameters, of the newest study in the campaign's vehicle that succeeded."""
    for study in studies.about(connection, campaign.id, campaign.sequence, None):
        succeeded = study.stage == StageName.ROBUSTNESS and study.state == CampaignState.SUCCEEDED
        if not succeeded or not studies.is_in_own_vehicle(study, campaign):
            continue
        document = studies.get(connection, study.campaign_sequence, StageName.ROBUSTNESS)
        if document is not None:
            return {key_of(item["parameters"]): item["degree"] for item in document["items"]}
    return {}

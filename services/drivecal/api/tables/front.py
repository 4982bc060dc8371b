"""Rows and summary of a campaign's front."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sqlalchemy import Connection

from drivecal.analysis.goals import Bound, Goal, Objective
from drivecal.analysis.optima import distances
from drivecal.api.tables.ranking import given_weights
from drivecal.campaigns.resolve.resolved_spec import ResolvedSpec
from drivecal.campaigns.results.front import EARLIER, CampaignFront
from drivecal.campaigns.results.optima import unit_cube
from drivecal.contracts.results import FrontGrowth, FrontObjective, FrontSummary, TradeOff, ValuePair
from drivecal.contracts.tables import FrontRow
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.parameters import ParameterSet
from drivecal.domain.scales import Direction, plain, unit_text
from drivecal.storage import studies
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import parameter_sets


@dataclass(frozen=True)
class FrontTable:
    """A front by rank, under weights of the objectives if they are given."""

    front: CampaignFront
    rows: Sequence[FrontRow]
    sets: Mapping[int, ParameterSet]

    def set_of(self, rank: int, field: str) -> tuple[FrontRow, ParameterSet]:
        """Returns a set of the front. Raises InvalidInputError naming `field` for a rank that it does not have."""
        if not 1 <= rank <= len(self.rows):
            raise InvalidInputError(Problem(field, f"the front has no set of rank {rank}", f"give 1 to {len(self.rows)}"))
        return self.rows[rank - 1], self.sets[self.front.members[rank - 1].solution.parameter_set]


def front_table(database: Database, campaign: StoredCampaign, front: CampaignFront, weights: str | None) -> FrontTable:
    """Returns the rows of a front. Raises InvalidInputError for unusable `weights` (`comfort=2,gap=1`)."""
    names = [goal.name for goal in front.goals.objectives]
    worths: Sequence[float | None] = [None] * len(front.members)
    if weights is not None:
        front, sums = front.by_weights(given_weights(weights, names, "objective"))
        worths = sums.tolist()
    with database.read() as connection:
        sets = parameter_sets.load(connection, [member.solution.parameter_set for member in front.members])
        degrees = _degrees(connection, campaign)
    winning = front.winning
    rows = []
    for place, member in enumerate(front.members):
        solution, parameters = member.solution, sets[member.solution.parameter_set].floats
        amounts = () if solution.judgement is None else solution.judgement.amounts
        rows.append(
            FrontRow(
                rank=place + 1,
                objectives=dict(zip(names, amounts, strict=True)),
                weighted=worths[place],
                violation=solution.shares_violated,
                knee=front.knee == place,
                best_in=[name for name, best in zip(names, front.extremes, strict=True) if best == place],
                wins=None if winning is None else winning[place].share,
                weights=None if winning is None else [list(corner) for corner in winning[place].corners],
                alternatives=member.alternatives,
                degree=degrees.get(_key(parameters)),
                scores={name: plain(score) for name, score in solution.scores.items()},
                reused=list(solution.reused),
                parameters=parameters,
                iteration=None if solution.iteration == EARLIER else solution.iteration,
                individual=None if solution.iteration == EARLIER else solution.individual,
            )
        )
    return FrontTable(front, rows, sets)


def summary(front: CampaignFront) -> FrontSummary:
    """Returns the summary of a front in its own order."""
    growth = [FrontGrowth(iteration=number, hypervolume=volume, size=size) for number, volume, size in front.hypervolumes()]
    listed = [
        _objective(goal, column, front, reference)
        for column, (goal, reference) in enumerate(zip(front.goals.objectives, front.reference, strict=True))
    ]
    return FrontSummary(
        objectives=listed,
        constraints=[_bound_text(bound) for bound in front.goals.bounds],
        evaluated=len(front.ranked),
        feasible=sum(solution.violation == 0 for solution in front.ranked),
        size=len(front.members),
        copied=sum(bool(member.solution.reused) for member in front.members),
        knee=None if front.knee is None else front.knee + 1,
        extremes={goal.name: best + 1 for goal, best in zip(front.goals.objectives, front.extremes, strict=False)},
        hypervolume=growth[-1].hypervolume if growth else None,
        growth=growth,
    )


def trade_off(table: FrontTable, resolved: ResolvedSpec, first: int, second: int) -> TradeOff:
    """Returns how two sets of a front differ. Raises InvalidInputError for ranks that it does not have."""
    row, before = table.set_of(first, "first")
    other, after = table.set_of(second, "second")
    places = unit_cube(resolved.space, [before, after])
    goals = table.front.goals.objectives
    compared = [
        ValuePair(
            name=goal.name,
            first=row.objectives[goal.name],
            second=other.objectives[goal.name],
            gain=goal.sign * (other.objectives[goal.name] - row.objectives[goal.name]),
        )
        for goal in goals
    ]
    sign = resolved.scale.sign
    return TradeOff(
        first=first,
        second=second,
        objectives=compared,
        scores=[
            ValuePair(name=name, first=score, second=other.scores[name], gain=sign * (other.scores[name] - score))
            for name, score in row.scores.items()
        ],
        parameters=[
            ValuePair(name=name, first=value, second=other.parameters[name])
            for name, value in row.parameters.items()
            if value != other.parameters[name]
        ],
        distance=float(distances(places[:1], places[1:])[0, 0]),
        text=[_text(goal, each) for goal, each in zip(goals, compared, strict=True)],
    )


def _text(goal: Objective, difference: ValuePair) -> str:
    gain = difference.gain or 0.0
    values = f"{difference.first:.6g} to {difference.second:.6g}{unit_text(goal.unit)}"
    return f"{goal.name} {'stays as it is' if gain == 0 else 'gets better' if gain > 0 else 'gets worse'}: {values}"


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


def _bound_text(bound: Bound) -> str:
    sign = ">=" if bound.sign > 0 else "<="
    return f"{_aggregate_text(bound)} of {bound.name} {sign} {bound.limit:g} ({', '.join(bound.shares)})"


def _degrees(connection: Connection, campaign: StoredCampaign) -> dict[tuple[tuple[str, float | str], ...], int]:
    """Degrees of robustness by parameters, of the newest study in the campaign's vehicle."""
    vehicle = campaign.spec["vehicle"]
    for study in studies.about(connection, campaign.id, campaign.sequence, None):
        document = studies.get(connection, study.campaign_sequence, StageName.ROBUSTNESS)
        if study.stage is StageName.ROBUSTNESS and study.spec["vehicle"] == vehicle and document is not None:
            return {_key(item["parameters"]): item["degree"] for item in document["items"]}
    return {}


def _key(parameters: Mapping[str, float | str]) -> tuple[tuple[str, float | str], ...]:
    return tuple(sorted(parameters.items()))

"""Rows and summary of a campaign's front."""

from collections.abc import Iterable, Sequence
from operator import attrgetter

from sqlalchemy import Connection

from drivecal.analysis.goals import FAILED, Bound, Goal, Goals, Objective, over_seeds
from drivecal.analysis.robustness import key_of
from drivecal.analysis.solutions import EvaluatedSet
from drivecal.api.tables.ranking import given_weights
from drivecal.campaigns.results.front import CampaignFront, answers_of
from drivecal.contracts.results import FrontBaseline, FrontGrowth, FrontObjective, FrontSummary
from drivecal.contracts.tables import FrontRow, JudgedSet
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.evaluations import CellScore
from drivecal.domain.scales import Direction, plain, unit_text
from drivecal.storage import studies
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.references import parameter_sets


def weighted(front: CampaignFront, weights: str | None) -> tuple[CampaignFront, Sequence[float | None]]:
    """Returns a front by rank and the weighted sums. Raises InvalidInputError for unusable `weights` (`comfort=2,gap=1`)."""
    if weights is None:
        return front, [None] * len(front.members)
    names = [goal.name for goal in front.goals.objectives]
    ordered, sums = front.by_weights(given_weights(weights, names, "objective"))
    return ordered, sums.tolist()


def front_table(front: CampaignFront, weights: str | None = None) -> list[FrontRow]:
    """Returns the rows of a front. Raises InvalidInputError for unusable `weights`."""
    names = [goal.name for goal in front.goals.objectives]
    front, worths = weighted(front, weights)
    with front.stored.database.read() as connection:
        sets = parameter_sets.load(connection, [member.solution.parameter_set for member in front.members])
        degrees = _degrees(connection, front.stored.campaign)
    winning, answers = front.winning, answers_of(front.stored, [member.solution for member in front.members])
    rows = []
    for place, member in enumerate(front.members):
        solution, parameters = member.solution, sets[member.solution.parameter_set].floats
        rows.append(
            FrontRow.of(
                solution,
                rank=place + 1,
                objectives=dict(zip(names, solution.judgement.amounts, strict=True)),
                uncertainty=dict(front.uncertainty.get(solution.parameter_set, {})),
                weighted=worths[place],
                undecided=solution.is_undecided,
                constraints=front.goals.named_bounds(solution.judgement),
                knee=front.knee == place,
                best_in=[name for name, best in zip(names, front.extremes, strict=True) if best == place],
                wins=None if winning is None else winning[place].share,
                weights=None if winning is None else [list(corner) for corner in winning[place].corners],
                alternatives=member.alternatives,
                failures=(front.stored.sets.get(solution.parameter_set) or solution).failures,
                degree=degrees.get(key_of(parameters)),
                scores={name: plain(score) for name, score in solution.scores.items()},
                values=front.goals.named_values(member.cells),
                answers=answers[solution.parameter_set],
                parameters=parameters,
            )
        )
    return rows


def judged_sets(front: CampaignFront) -> list[JudgedSet]:
    """Returns every evaluated set by its objectives, in the order of the ranking."""
    names = [goal.name for goal in front.goals.objectives]
    return [
        JudgedSet.of(
            solution,
            objectives=dict(zip(names, solution.judgement.amounts, strict=True)),
            on_front=solution.parameter_set in front.ranks,
        )
        for solution in front.ranked
    ]


def summary(front: CampaignFront) -> FrontSummary:
    """Returns the summary of a front in its order."""
    return FrontSummary(
        objectives=[_objective(goal, column, front) for column, goal in enumerate(front.goals.objectives)],
        constraints=[bound_text(bound) for bound in front.goals.bounds],
        evaluated=len(front.ranked),
        feasible=sum(solution.violation == 0 for solution in front.ranked),
        size=len(front.members),
        close=front.close,
        copied=sum(bool(member.solution.reused) for member in front.members),
        knee=None if front.knee is None else front.knee + 1,
        extremes={goal.name: best + 1 for goal, best in zip(front.goals.objectives, front.extremes, strict=False)},
        baseline=None if front.baseline is None else _baseline(front, front.baseline),
        growth=[FrontGrowth(iteration=number, size=size, new=new) for number, size, new in front.growth()],
    )


def _baseline(front: CampaignFront, baseline: EvaluatedSet) -> FrontBaseline:
    names = [goal.name for goal in front.goals.objectives]
    runs: dict[str, dict[int, CellScore]] = {}
    own = [cell for cell in front.stored.answers if cell.parameter_set == baseline.parameter_set]
    for cell in sorted(own, key=attrgetter("worth")):  # of each run, the worthiest answer is the last
        if not baseline.seeds or cell.seed in baseline.seeds:
            runs.setdefault(cell.scenario, {})[cell.seed] = cell
    return FrontBaseline.of(
        baseline,
        objectives=dict(zip(names, baseline.judgement.amounts, strict=True)),
        undecided=baseline.is_undecided,
        constraints=front.goals.named_bounds(baseline.judgement),
        values=front.goals.named_values({scenario: over_seeds(list(cells.values())) for scenario, cells in runs.items()}),
        rank=front.ranks.get(baseline.parameter_set),
    )


def _objective(goal: Objective, column: int, front: CampaignFront) -> FrontObjective:
    amounts = [member.solution.judgement.amounts[column] for member in front.members]
    return FrontObjective.of(
        goal,
        direction=(Direction.MAXIMISE if goal.sign > 0 else Direction.MINIMISE).value,
        aggregate=_aggregate_text(goal),
        scenarios=dict(goal.shares),
        best=max(amounts, key=lambda amount: goal.sign * amount, default=None),
        worst=min(amounts, key=lambda amount: goal.sign * amount, default=None),
    )


def _aggregate_text(goal: Goal) -> str:
    return f"quantile {goal.aggregate.level:g}" if goal.aggregate.kind == "quantile" else goal.aggregate.kind


def bound_text(bound: Bound) -> str:
    """Returns a constraint in words."""
    kept = f"{bound.name} {'>=' if bound.sign > 0 else '<='} {bound.limit:.10g}{unit_text(bound.unit)}"
    if bound.rate is not None:
        what = "that fail" if bound.value.measure == FAILED else f"without {kept}"
        return f"share of runs {what} <= {bound.rate:g}, at {bound.confidence:g} ({', '.join(bound.shares)})"
    if bound.value.change is not None:  # of the set, whatever the scenario
        return kept
    return f"{_aggregate_text(bound)} of {kept} ({', '.join(bound.shares)})"


def bounded_texts(goals: Goals, amounts: Iterable[float], seeds: int) -> list[str]:
    """Returns each constraint in words with a set's amount, of a rate with the bounds of the share; `amounts`: as `Judged.bounded`."""
    mean = " in the mean of its seeds" if seeds > 1 else ""
    given, texts = iter(amounts), []
    for bound in goals.bounds:
        amount = f"{next(given):.8g}"
        if bound.rate is not None:
            amount += f" ({next(given):.3g} to {next(given):.3g})"
        else:
            amount += unit_text(bound.unit) + (mean if bound.value.change is None else "")
        texts.append(f"{bound_text(bound)}: {amount}")
    return texts


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

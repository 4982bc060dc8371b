"""Ranking of the evaluated sets of a campaign."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drivecal.analysis.solutions import EvaluatedSet as Ranked
from drivecal.analysis.solutions import Ranking
from drivecal.campaigns.resolve.resolved_spec import ResolvedSpec
from drivecal.contracts.assignments import assignments
from drivecal.contracts.tables import Solution
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.storage import results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import parameter_sets

LARGEST_WEIGHT = 1e6


@dataclass(frozen=True)
class CampaignRanking:
    """The ranked parameter sets of a campaign; their values are read only for those that are shown."""

    database: Database
    ranked: Sequence[Ranked]
    scenarios: Sequence[str]

    def __len__(self) -> int:
        return len(self.ranked)

    def solutions(self, start: int, stop: int) -> list[Solution]:
        """Returns the solutions of ranks `start` + 1 to `stop`."""
        shown = self.ranked[start:stop]
        with self.database.read() as connection:
            sets = parameter_sets.load(connection, [solution.parameter_set for solution in shown])
        return [
            Solution(
                rank=rank,
                objective=solution.objective,
                rating=solution.rating,
                parameters=sets[solution.parameter_set].floats,
                scores=dict(solution.scores),
                reused=list(solution.reused),
                iteration=solution.iteration,
                individual=solution.individual,
            )
            for rank, solution in enumerate(shown, start + 1)
        ]


def ranking(database: Database, campaign: StoredCampaign, resolved: ResolvedSpec, weights: str | None) -> CampaignRanking:
    """Returns the ranking by the campaign's first objective, or by its score under `weights` (`S1=2,S2=1`).

    A copied score gives way to a later simulation of the very cell. Raises InvalidInputError for unusable weights.
    """
    used = resolved.weights if weights is None else _weights(weights, list(resolved.weights))
    goals = resolved.goals if weights is None else None
    valued = goals.values if goals is not None and goals.computed else None
    standing = Ranking(used, resolved.scale.sign, goals)
    with database.read() as connection:
        answers = results.answers(
            connection, campaign.sequence, StageName.CALIBRATION, corrected_by=resolved.evaluator, valued=valued
        )
        standing.add(answers)
    return CampaignRanking(database, standing.ranking(), [name for name, weight in used.items() if weight > 0])


def _weights(text: str, simulated: Sequence[str]) -> Mapping[str, float]:
    """Returns weights by scenario in the campaign's order; scenarios that are not named have weight 1, as in a campaign file."""
    given = assignments(text.split(","), "weights")
    problems: list[Problem] = []
    for name, weight in given.items():
        where = f"weights.{name}"
        if name not in simulated:
            problems.append(Problem(where, "the campaign did not simulate this scenario", f"one of {', '.join(simulated)}"))
        elif not 0 <= weight <= LARGEST_WEIGHT:
            problems.append(Problem(where, f"{weight:g} is no weight", f"give a number from 0 to {LARGEST_WEIGHT:,.0f}"))
    weights = {name: given.get(name, 1.0) for name in simulated}
    if not problems and not any(weights.values()):
        problems.append(Problem("weights", "all weights are 0", "give at least one scenario a positive weight"))
    if problems:
        raise InvalidInputError(*problems)
    return weights

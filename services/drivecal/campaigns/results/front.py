"""The ranking of a campaign by stored rows, and its front: the non-dominated sets, and how they were answered."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import groupby, takewhile
from operator import attrgetter

import numpy as np

from drivecal.analysis import replicates
from drivecal.analysis.front import WinningWeights, by_weights, extremes, knee, non_dominated, winning_weights
from drivecal.analysis.goals import Goals
from drivecal.analysis.optima import regions
from drivecal.analysis.solutions import EvaluatedSet, FrontMember, Ranking
from drivecal.campaigns.resolve.resolved_spec import ResolvedSpec, resolved_spec
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import CellScore, Outcome
from drivecal.domain.parameters import ParameterSet, ParameterSpace
from drivecal.plugins.ports import Floats
from drivecal.reduction.prediction import FeatureSpace
from drivecal.storage import results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import parameter_sets

MOST_BEST = 10_000
"""Largest number of best sets to compare, best rated first: the work grows with its square."""
_COPIED = {Outcome.REUSED, Outcome.PREDICTED, Outcome.FAILED}


@dataclass(frozen=True)
class StoredRanking:
    """The sets of a calibration, ranked by weights and goals. Their answers are read when they are first needed, and once.

    A copied score gives way to a later simulation of the very cell. A `watermark` excludes simulations that a campaign with it does not
    see: 0 excludes all.
    """

    database: Database
    campaign: StoredCampaign
    resolved: ResolvedSpec
    watermark: int | None = None
    whole: "StoredRanking | None" = None
    """A ranking with the same answers."""

    @classmethod
    def of(cls, database: Database, campaign: StoredCampaign, watermark: int | None = None) -> "StoredRanking":
        """Returns the ranking by the campaign's own weights and goals."""
        return cls(database, campaign, resolved_spec(campaign), watermark)

    @cached_property
    def answers(self) -> Sequence[CellScore]:
        """All answers of the search."""
        if self.whole is not None:
            return self.whole.answers
        evaluator, valued = self.resolved.evaluator, self.resolved.goals.valued
        with self.database.read() as connection:
            here = connection, self.campaign.sequence, StageName.CALIBRATION
            return list(results.answers(*here, corrected_by=evaluator, watermark=self.watermark, valued=valued))

    @cached_property
    def sets(self) -> Ranking:
        """The ranked sets."""
        ranking = Ranking(self.resolved.weights, self.resolved.goals, self.resolved.replicates)
        ranking.add(self.answers)
        return ranking

    def best_regions(self) -> int:
        """Returns the number of regions of the first sets that share the best objective: at most MOST_BEST."""
        ranking = self.sets.best_first()
        best = takewhile(lambda each: each.choice.equals(ranking[0].choice), ranking[:MOST_BEST])
        sets = self.database.query(parameter_sets.load, [each.parameter_set for each in best])
        return len(set(regions_of(self.resolved.space, list(sets.values()))))

    def under(self, resolved: ResolvedSpec) -> "StoredRanking":
        """Returns the ranking of the same answers by other weights, or for a variant: goals that need no other values of runs."""
        return self if resolved is self.resolved else replace(self, resolved=resolved, whole=self)


@dataclass(frozen=True)
class CampaignFront:
    """All sets with every objective, by the seeds that choose, best first, and the members of the front in their order."""

    stored: StoredRanking
    ranked: Sequence[EvaluatedSet]
    members: Sequence[FrontMember]
    uncertainty: Mapping[int, Mapping[str, float]] = field(default_factory=dict)
    """Standard error and interval of each objective by the id of a set; empty without randomness, and before the noise is known."""
    close: int = 0
    """Further sets that cannot be told from sets that no other set dominates."""
    reports: Mapping[int, EvaluatedSet] = field(default_factory=dict)
    """Sets by the seeds that report them, by their ids, if others chose them and there is one objective."""
    unbeaten: frozenset[int] = frozenset()
    """Ids of the sets of a random simulator that no member is known to beat in every objective."""

    @property
    def goals(self) -> Goals:
        """Objectives and constraints of the ranking."""
        return self.stored.resolved.goals

    @cached_property
    def baseline(self) -> EvaluatedSet | None:
        """The campaign's baseline, the first set of its search, as it was evaluated; None without one."""
        campaign = self.stored.campaign
        first = next((each for each in self.ranked if (each.iteration, each.individual) == (0, 0)), None)
        if first is None or campaign.baseline is None:
            return None
        known = self.stored.database.query(parameter_sets.load, [first.parameter_set])[first.parameter_set]
        return first if known.floats == campaign.baseline.parameters else None

    @cached_property
    def points(self) -> Floats:
        """Objectives, shape (n, m); higher is better."""
        return self._signed([member.solution for member in self.members])

    @cached_property
    def ranks(self) -> Mapping[int, int]:
        """Rank of every set on the front, as a member or as an alternative of one, by its id."""
        return {number: rank for rank, member in enumerate(self.members, 1) for number in member.alike}

    @cached_property
    def is_feasible(self) -> bool:
        """True if the sets of the front keep all constraints."""
        return bool(self.members) and self.members[0].solution.violation == 0

    @cached_property
    def knee(self) -> int | None:
        """Position of the knee."""
        return knee(self.points) if self.is_feasible else None

    @cached_property
    def extremes(self) -> list[int]:
        """Position of the best set of each objective; empty without a front."""
        return extremes(self.points) if self.members else []

    @cached_property
    def winning(self) -> list[WinningWeights] | None:
        """Weights under which each set wins; None if they are not computed."""
        return winning_weights(self.points) if self.members else []

    def growth(self) -> list[tuple[int, int, int]]:
        """Returns the size of the front after each iteration, and how many of its points are new, by the sets first seen up to it."""
        front = np.empty((0, len(self.goals.objectives)))
        grown: list[tuple[int, int, int]] = []
        feasible = sorted((each for each in self.ranked if each.violation == 0), key=attrgetter("iteration"))
        for iteration, members in groupby(feasible, attrgetter("iteration")):
            points = np.concatenate([front, self._signed(list(members))])
            before, front = {tuple(row) for row in front.tolist()}, np.unique(points[non_dominated(points)], axis=0)
            grown.append((int(iteration), len(front), sum(tuple(row) not in before for row in front.tolist())))
        return grown

    def dominating(self, solution: EvaluatedSet) -> int:
        """Returns the number of members that are better than a set in an objective and worse in none, or break constraints less."""
        if not self.members:
            return 0
        if self.members[0].solution.violation < solution.violation:
            return len(self.members)
        point = np.array(self.goals.compared(solution.judgement))
        gains, slacks = self.points - point, self.goals.slacks(self.points, point)
        return int(((gains >= -slacks).all(axis=1) & (gains > slacks).any(axis=1)).sum())

    def by_weights(self, weights: Mapping[str, float]) -> tuple["CampaignFront", Floats]:
        """The same front, best first by the weighted sum of the objectives scaled to it, with the sums, shape (n,)."""
        if not self.members:
            return self, np.empty(0)
        order, worths = by_weights(self.points, np.array([weights[goal.name] for goal in self.goals.objectives]))
        return replace(self, members=[self.members[place] for place in order]), worths[order]

    def _signed(self, sets: Sequence[EvaluatedSet]) -> Floats:
        return self.goals.signed(each.judgement for each in sets)


def front_of(stored: StoredRanking) -> CampaignFront:
    """Returns the front of a campaign's search."""
    goals, ranking, confidence = stored.resolved.goals, stored.sets, stored.resolved.replicates.confidence
    ranked = ranking.best_first()
    reports = {each.parameter_set: each for each in ranked if each.chosen_by is not None and len(goals.objectives) == 1}
    front = CampaignFront(stored, [each.choice for each in ranked], ranking.front(), reports=reports)
    numbers, known = ranking.by_objective()
    if not known or not front.members or not all(each.is_known for each in known):
        return front
    columns: dict[str, Floats] = {}
    for goal, each in zip(goals.objectives, known, strict=True):
        middles, halves = goal.sign * each.means, each.half_widths(confidence)
        ends = {"error": each.standard_errors, "lower": middles - halves, "upper": middles + halves}
        columns |= {f"{goal.name}_{end}": values for end, values in ends.items()}
    uncertainty = {number: {name: float(values[n]) for name, values in columns.items()} for n, number in enumerate(numbers)}
    places = [place for place, number in enumerate(numbers) if number in front.ranks]
    least = front.members[0].solution.violation
    rivals = {each.parameter_set for each in front.ranked if each.violation <= least or each.is_undecided} - front.ranks.keys()
    unbeaten = frozenset(np.array(numbers)[replicates.unbeaten(known, places, confidence)].tolist())
    return replace(front, uncertainty=uncertainty, close=len(unbeaten & rivals), unbeaten=unbeaten)


def regions_of(space: ParameterSpace, sets: Sequence[ParameterSet]) -> list[int]:
    """Returns the region of each set: root mean squares of differences are shares of the ranges, and another choice is a whole range
    away."""
    columns = FeatureSpace(space)(sets).T
    parts = [
        np.sqrt(0.5) * (column == np.unique(column)[:, np.newaxis]) if parameter.choices else column[np.newaxis]
        for parameter, column in zip(space.searched, columns, strict=True)
    ]
    points = np.concatenate(parts).T
    return list(map(int, regions(points * np.sqrt(points.shape[1] / len(columns)))))  # distances are means over columns


def answers_of(stored: StoredRanking, sets: Sequence[EvaluatedSet]) -> dict[int, dict[str, str]]:
    """Returns how sets were answered, by their ids and by scenario, in the words of `FrontRow.answers`."""
    cells: dict[tuple[int, str], list[Outcome]] = {}
    with stored.database.read() as connection:
        numbers = [solution.parameter_set for solution in sets]
        for number, scenario, outcome in results.outcomes_of(connection, stored.campaign.sequence, numbers):
            cells.setdefault((number, scenario), []).append(outcome)
    return {
        solution.parameter_set: {
            scenario: _answer(cells.get((solution.parameter_set, scenario), []), copied=scenario in solution.reused)
            for scenario in solution.scores
        }
        for solution in sets
    }


def _answer(outcomes: Sequence[Outcome], *, copied: bool) -> str:
    if copied:
        return Outcome.REUSED
    own = [outcome for outcome in outcomes if outcome not in _COPIED]
    if not own:
        return "stored"
    return "confirmed" if outcomes[0] in {Outcome.REUSED, Outcome.PREDICTED} and own[0] is Outcome.SIMULATED else own[0]

"""Ranks evaluated parameter sets by their weighted objective (Eq. 6) under any weights, without a simulation. Pure.

With several objectives or constraints, sets are ranked by the first objective, feasible ones first, and the others make a front.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivecal.analysis.goals import Goals, Judged
from drivecal.domain.evaluations import CellScore
from drivecal.domain.rounding import levels, same
from drivecal.plugins.ports import Floats


@dataclass(frozen=True, slots=True)
class EvaluatedSet:
    """A parameter set with a result in every weighted scenario; `iteration` and `individual` locate its first occurrence."""

    parameter_set: int
    objective: float
    rating: float
    scores: Mapping[str, float]
    reused: tuple[str, ...]
    """Scenarios whose score is a reference's or a prediction, also if it counts for goals alone: this very set was not simulated there."""
    iteration: int
    individual: int
    sign: int = 1
    """Of the scale: -1 if lower objectives are better."""
    judgement: Judged | None = None
    """All objectives and the violations; None without goals."""
    span: float = 0.0
    """Width of the objective's declared range; 0 without one."""

    @property
    def violation(self) -> float:
        """Sum of the violations of constraints, in shares."""
        return 0.0 if self.judgement is None else self.judgement.violation

    def equals(self, other: "EvaluatedSet") -> bool:
        """Returns whether objective and violation are the same but for rounding."""
        return same(self.objective, other.objective, self.span) and same(self.violation, other.violation)


@dataclass(frozen=True, slots=True)
class FrontMember:
    """A set of the front, its answers by scenario, and the ids of the sets with the same objectives, itself included."""

    solution: EvaluatedSet
    alike: frozenset[int]
    cells: Mapping[str, CellScore]

    @property
    def alternatives(self) -> int:
        """Number of sets with the same objectives."""
        return len(self.alike)


class Ranking:
    """All parameter sets with their scores, under one choice of weights; grows as answers arrive."""

    def __init__(self, weights: Mapping[str, float], sign: int = 1, goals: Goals | None = None, span: float = 1.0) -> None:
        """`weights` by scenario need not be normalised; scenarios of weight 0 and those not named count for goals alone. `sign`: the
        scale's. `goals`: their first objective ranks in the place of the weighted score. `span`: width of the scale's range."""
        self._sign, self._goals = sign, goals
        self._span = span if goals is None else goals.objectives[0].span
        total = sum(weights.values())
        self._shares = {name: weight / total for name, weight in weights.items() if weight > 0}
        judged = () if goals is None else (*goals.objectives, *goals.bounds)
        self._scenarios = {*self._shares, *(scenario for goal in judged for scenario in goal.shares)}
        self._answers: dict[int, dict[str, CellScore]] = {}
        self._places: dict[int, tuple[int, int]] = {}
        self._solutions: dict[int, EvaluatedSet] = {}
        self._predicted: dict[int, EvaluatedSet] = {}
        """Sets with a predicted score, which have no rank."""
        self._surest_front: list[Judged] | None = None
        self._best: tuple[EvaluatedSet, int] | None = None
        self._levels: dict[int, tuple[int, int]] | None = None
        """Places among the distinct violations and objectives, best first, by the id of a set."""

    def add(self, answers: Iterable[CellScore]) -> None:
        """Takes answers in, in any order. A set with a predicted score takes no place in the ranking."""
        touched: set[int] = set()
        for answer in answers:
            number = answer.parameter_set
            place = (answer.iteration, answer.individual)
            self._places[number] = min(self._places.get(number, place), place)
            cells = self._answers.setdefault(number, {})
            if answer.scenario in self._scenarios and _counts_more(answer, cells.get(answer.scenario)):
                cells[answer.scenario] = answer
            touched.add(number)
        self._surest_front = self._best = self._levels = None
        for number in touched:
            solution = self._solution(number)
            if solution is None:
                continue
            if any(cell.predicted for cell in self._answers[number].values()):
                self._predicted[number] = solution
            else:
                self._solutions[number] = solution
                self._predicted.pop(number, None)

    def order(self, solution: EvaluatedSet) -> tuple[int, int, float, int, int]:
        """Sorts best first: feasible sets first, equal objectives by the weighted continuous rating, then by discovery."""
        if self._levels is None:
            known = list((self._solutions | self._predicted).values())
            violations = levels(np.array([each.violation for each in known])).tolist()
            objectives = levels(np.array([-each.sign * each.objective for each in known]), self._span).tolist()
            numbers = (each.parameter_set for each in known)
            self._levels = dict(zip(numbers, zip(violations, objectives, strict=True), strict=True))
        rating = -solution.sign * solution.rating
        return *self._levels[solution.parameter_set], rating, solution.iteration, solution.individual

    def ranking(self) -> list[EvaluatedSet]:
        """All solutions, best first."""
        return sorted(self._solutions.values(), key=self.order)

    def best(self) -> tuple[EvaluatedSet, int] | None:
        """The best solution and how many share its objective, itself included; None before the first."""
        if not self._solutions or self._best is not None:
            return self._best
        best = min(self._solutions.values(), key=self.order)
        first = self.order(best)[:2]
        self._best = best, sum(self.order(solution)[:2] == first for solution in self._solutions.values())
        return self._best

    def surest(self) -> EvaluatedSet | None:
        """The best solution whose scores are all its own; None without one."""
        own = (solution for solution in self._solutions.values() if not solution.reused)
        return min(own, key=self.order, default=None)

    def doubtful(self, tried: Collection[int] = ()) -> EvaluatedSet | None:
        """The best set with a copied or predicted score that would rank before `surest`, but for those `tried`, by their ids; None without
        one."""
        if self._goals is not None and self._goals.is_vector:
            return self._doubtful_on_front(tried)
        surest = self.surest()
        candidates = [
            candidate
            for number, candidate in (self._solutions | self._predicted).items()
            if candidate.reused and number not in tried and (surest is None or self.order(candidate) < self.order(surest))
        ]
        return min(candidates, key=self.order, default=None)

    def front(self) -> list[FrontMember]:
        """The sets that no other set dominates, best first objective first, each vector of objectives once: of equal ones a set whose
        scores are all its own, then the first of the ranking. Infeasible ones only while no set is feasible. Needs goals."""
        return self._front(self._solutions.values())

    def reaches_front(self, cells: Mapping[str, CellScore]) -> bool:
        """Returns whether no set with scores of its own dominates one with these cells, nor has the same objectives. Needs goals."""
        if self._goals is None:
            raise ValueError("there are no goals")
        judgement = self._goals.judge(cells)
        if judgement is None:
            return False
        known = self._sure_front()
        points, point = self._goals.signed(known), np.array(self._goals.compared(judgement))
        as_good = np.all(points - point >= -self._goals.slacks(points, point), axis=1)
        return not any(
            is_as_good if same(each.violation, judgement.violation) else each.violation < judgement.violation
            for each, is_as_good in zip(known, as_good.tolist(), strict=True)
        )

    def _sure_front(self) -> list[Judged]:
        if self._surest_front is None:
            own = self._front(solution for solution in self._solutions.values() if not solution.reused)
            self._surest_front = [each for member in own if (each := member.solution.judgement) is not None]
        return self._surest_front

    def _doubtful_on_front(self, tried: Collection[int]) -> EvaluatedSet | None:
        """The first doubtful set of the front that all sets would make, but for those tried. Without one, the best set if it is doubtful:
        a copied set may rank before one of its own scores and equal objectives, in whose place the front does not hold it."""
        believed = [
            solution
            for number, solution in (self._solutions | self._predicted).items()
            if not solution.reused or number not in tried
        ]
        on_front = next((member.solution for member in self._front(believed) if member.solution.reused), None)
        best = None if on_front is not None else self.best()
        return on_front if best is None or not best[0].reused or best[0].parameter_set in tried else best[0]

    def _front(self, solutions: Iterable[EvaluatedSet]) -> list[FrontMember]:
        if self._goals is None:
            raise ValueError("there are no goals")
        judged = [(solution, solution.judgement) for solution in solutions if solution.judgement is not None]
        if not judged:
            return []
        points = self._goals.signed(judgement for _, judgement in judged)
        kept = self._goals.leading(points, np.array([solution.violation for solution, _ in judged]))
        ordered = sorted(np.flatnonzero(kept).tolist(), key=lambda place: self.order(judged[place][0]))
        alike = [[judged[ordered[place]][0] for place in group] for group in self._alike(self._goals, points[ordered])]
        members = [
            FrontMember(first, frozenset(each.parameter_set for each in sets), self._answers[first.parameter_set])
            for sets in alike
            for first in [min(sets, key=lambda each: bool(each.reused))]
        ]
        return sorted(members, key=lambda member: self.order(member.solution))

    @staticmethod
    def _alike(goals: Goals, points: Floats) -> Sequence[Sequence[int]]:
        """Groups points by the first one that they equal but for what does not count."""
        groups: list[list[int]] = []
        firsts = np.empty_like(points)
        for place, point in enumerate(points):
            known = firsts[: len(groups)]
            equal = np.flatnonzero((np.abs(known - point) <= goals.slacks(known, point)).all(axis=1))
            if equal.size:
                groups[int(equal[0])].append(place)
            else:
                firsts[len(groups)] = point
                groups.append([place])
        return groups

    def get(self, parameter_set: int) -> EvaluatedSet | None:
        """A parameter set's solution, None if a result is missing; `parameter_set` is its id."""
        return self._solutions.get(parameter_set)

    def _solution(self, number: int) -> EvaluatedSet | None:
        cells = self._answers[number]
        objective = rating = 0.0
        scores: dict[str, float] = {}
        reused: list[str] = []
        for scenario, share in self._shares.items():
            cell = cells.get(scenario)
            if cell is None or cell.score is None or cell.rating is None:
                return None
            objective += share * cell.score
            rating += share * cell.rating
            scores[scenario] = cell.score
            if not cell.own:
                reused.append(scenario)
        bounding = sorted(self._scenarios.difference(self._shares))
        reused += [scenario for scenario in bounding if scenario in cells and not cells[scenario].own]
        solution = EvaluatedSet(
            number, objective, rating, scores, tuple(reused), *self._places[number], self._sign, span=self._span
        )
        if self._goals is None:
            return solution
        judgement = self._goals.judge(cells)
        if judgement is None:
            return None
        first = self._goals.objectives[0]
        if not first.is_weighted_mean(self._shares):
            rating = judgement.amounts[0]
        return replace(solution, objective=judgement.amounts[0], rating=rating, sign=first.sign, judgement=judgement)


def _counts_more(new: CellScore, known: CellScore | None) -> bool:
    """Returns whether an answer takes the place of another one for the same cell: a result counts more than none, an own one than a copy,
    a copy than a prediction, an earlier one than a later one."""
    if known is None:
        return True

    def worth(answer: CellScore) -> tuple[bool, bool, bool, int, int]:
        return answer.score is not None, answer.own, not answer.predicted, -answer.iteration, -answer.individual

    return worth(new) > worth(known)

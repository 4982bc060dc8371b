"""Ranks evaluated parameter sets by their weighted objective (Eq. 6) under any weights, without a simulation. Pure."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from drivecal.domain.evaluations import CellScore

EQUAL = 1e-9
"""Objectives that differ by no more than this are equal: alternatives of each other."""


@dataclass(frozen=True, slots=True)
class EvaluatedSet:
    """A parameter set with a result in every weighted scenario; `iteration` and `individual` locate its first occurrence."""

    parameter_set: int
    objective: float
    rating: float
    scores: Mapping[str, float]
    reused: tuple[str, ...]
    """Scenarios whose score is a reference's or a prediction: this very set was not simulated there."""
    iteration: int
    individual: int
    sign: int = 1
    """-1 if lower objectives are better."""

    @property
    def order(self) -> tuple[int, float, int, int]:
        """Sorts best first: equal objectives by the weighted continuous rating, then by discovery."""
        return -self.sign * round(self.objective / EQUAL), -self.sign * self.rating, self.iteration, self.individual


class Ranking:
    """All parameter sets with their scores, under one choice of weights; grows as answers arrive."""

    def __init__(self, weights: Mapping[str, float], sign: int = 1) -> None:
        """`weights` by scenario need not be normalised; scenarios of weight 0 and those not named take no part. `sign`: the scale's."""
        self._sign = sign
        total = sum(weights.values())
        self._shares = {name: weight / total for name, weight in weights.items() if weight > 0}
        self._answers: dict[int, dict[str, CellScore]] = {}
        self._places: dict[int, tuple[int, int]] = {}
        self._solutions: dict[int, EvaluatedSet] = {}
        self._predicted: dict[int, EvaluatedSet] = {}
        """Sets with a predicted score, which have no rank."""

    def add(self, answers: Iterable[CellScore]) -> None:
        """Takes answers in, in any order. A set with a predicted score takes no place in the ranking."""
        touched: set[int] = set()
        for answer in answers:
            number = answer.parameter_set
            place = (answer.iteration, answer.individual)
            self._places[number] = min(self._places.get(number, place), place)
            cells = self._answers.setdefault(number, {})
            if answer.scenario in self._shares and _counts_more(answer, cells.get(answer.scenario)):
                cells[answer.scenario] = answer
            touched.add(number)
        for number in touched:
            solution = self._solution(number)
            if solution is None:
                continue
            if any(cell.predicted for cell in self._answers[number].values()):
                self._predicted[number] = solution
            else:
                self._solutions[number] = solution
                self._predicted.pop(number, None)

    def ranking(self) -> list[EvaluatedSet]:
        """All solutions, best first."""
        return sorted(self._solutions.values(), key=lambda solution: solution.order)

    def best(self) -> tuple[EvaluatedSet, int] | None:
        """The best solution and how many share its objective, itself included; None before the first."""
        if not self._solutions:
            return None
        best = min(self._solutions.values(), key=lambda solution: solution.order)
        equal = sum(1 for solution in self._solutions.values() if abs(solution.objective - best.objective) <= EQUAL)
        return best, equal

    def surest(self) -> EvaluatedSet | None:
        """The best solution whose scores are all its own; None without one."""
        own = (solution for solution in self._solutions.values() if not solution.reused)
        return min(own, key=lambda solution: solution.order, default=None)

    def doubtful(self, tried: Collection[int] = ()) -> EvaluatedSet | None:
        """The best set with a copied or predicted score that would rank before `surest`, but for those `tried`, by their ids; None without
        one."""
        surest = self.surest()
        candidates = [
            candidate
            for number, candidate in (self._solutions | self._predicted).items()
            if candidate.reused and number not in tried and (surest is None or candidate.order < surest.order)
        ]
        return min(candidates, key=lambda solution: solution.order, default=None)

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
        return EvaluatedSet(number, objective, rating, scores, tuple(reused), *self._places[number], self._sign)


def _counts_more(new: CellScore, known: CellScore | None) -> bool:
    """Whether an answer takes the place of another one for the same cell: a result counts more than none, an own one than a copy,
    a copy than a prediction, an earlier one than a later one."""
    if known is None:
        return True

    def worth(answer: CellScore) -> tuple[bool, bool, bool, int, int]:
        return answer.score is not None, answer.own, not answer.predicted, -answer.iteration, -answer.individual

    return worth(new) > worth(known)

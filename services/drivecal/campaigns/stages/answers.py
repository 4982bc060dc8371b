"""The answers of a search as it is told them, and the ranking of all sets so far."""

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from operator import gt
from typing import Any

import numpy as np
from sqlalchemy import Connection

from drivecal.analysis.aims import JudgedGoals, WeightedScore
from drivecal.analysis.goals import over_seeds
from drivecal.analysis.solutions import Ranking
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.stages.asking import AskedRound, cells_of
from drivecal.contracts.campaign import GenerationCounts
from drivecal.contracts.tables import Generation
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import CellScore
from drivecal.domain.parameters import Indices
from drivecal.plugins.ports import Floats
from drivecal.plugins.search import CellAnswer
from drivecal.storage import evaluations, generations, results


class SearchAnswers(ABC):
    """The answers of a search."""

    def __init__(self, problem: CalibrationProblem) -> None:
        self._problem, self._goals = problem, problem.goals
        wanted = problem.specification.replicates
        self.ranking = Ranking(problem.weights, problem.goals, wanted)
        self.variants = {name: Ranking(goals.objectives[0].shares, goals, wanted) for name, goals in problem.variants.items()}
        """Rankings for each variant alone."""
        budget = None if problem.optimization is None else problem.optimization.budget
        self._follows_front = len(self._goals.objectives) > 1 and budget is not None and budget.stagnation is not None
        self._before = self._standing()

    def add(self, answers: Sequence[CellScore]) -> None:
        """Ranks answers."""
        for ranking in (self.ranking, *self.variants.values()):
            ranking.add(answers)

    def has_better_set(self) -> bool:
        """Returns whether the answers that were read last give a variant a better set, or the front of several objectives a new one."""
        (bests, front), (before, earlier) = self._standing(), self._before
        known = frozenset().union(*earlier)  # of sets with equal objectives another one may stand for all
        return any(map(gt, bests, before)) or any(alike.isdisjoint(known) for alike in front)

    def _standing(self) -> tuple[list[tuple[float, float]], list[frozenset[int]]]:
        bests = [ranking.best() for ranking in self.variants.values()]
        front = self.ranking.front() if self._follows_front else []
        return (
            [(-np.inf, 0.0) if best is None else (-best[0].violation, best[0].sign * best[0].objective) for best in bests],
            [member.alike for member in front],
        )

    def take_in(self, connection: Connection, campaign: int, iterations: Collection[int]) -> None:
        """Reads the answers of iterations."""
        if not iterations:
            return
        self._before = self._standing()
        only = next(iter(iterations)) if len(iterations) == 1 else None
        taken = [answer for answer in self.read(connection, campaign, only) if answer.iteration in iterations]
        for answer in taken:
            self._take(answer)
        self.add(taken)

    def read(self, connection: Connection, campaign: int, iteration: int | None) -> list[CellScore]:
        """Returns the answered cells of one iteration, or of all, with the values that the goals need."""
        return list(results.answers(connection, campaign, StageName.CALIBRATION, iteration, valued=self._goals.valued))

    def figures(self, number: int, cells: GenerationCounts, objectives: Floats) -> Generation:
        """Returns the figures of a round with these counts and objectives, shape (n,), NaN without a result."""
        best, known = self.ranking.best(), objectives[~np.isnan(objectives)]
        worst = known.min if self._goals.objectives[0].sign > 0 else known.max
        return Generation(
            **cells.model_dump(),
            iteration=number,
            best=None if best is None else best[0].objective,
            rating=None if best is None else best[0].rating,
            mean=float(known.mean()) if known.size else None,
            minimum=float(worst()) if known.size else None,
            alternatives=0 if best is None else best[1],
        )

    def settle(self, population: Indices) -> None:
        """Notes that a population is answered."""
        del population

    @abstractmethod
    def _take(self, answer: CellScore) -> None:
        """Takes an answer."""

    @abstractmethod
    def objectives(self, number: int) -> Floats:
        """Returns the objective of each individual of a round, shape (n,); NaN without a result in every scenario."""

    @abstractmethod
    def for_search(self, number: int, asked: AskedRound) -> tuple[Any, ...]:
        """Returns the arguments of an asker's `tell` for an answered round."""


class CellAnswers(SearchAnswers):
    """The answers of a search by the cell, by round."""

    def __init__(self, problem: CalibrationProblem) -> None:
        super().__init__(problem)
        names = tuple(problem.scenarios)
        scale = problem.bench.scale
        if problem.bench.is_random:  # the mean of rounded scores has no steps
            scale = replace(scale, step=None)
        is_score = problem.goals.is_weighted_score
        self.aim = WeightedScore(problem.weights, scale) if is_score else JudgedGoals(problem.goals, names)
        self.aims_of_variants: list[WeightedScore | JudgedGoals] = [
            WeightedScore({name: goals.objectives[0].shares.get(name, 0.0) for name in names}, scale)
            if is_score
            else JudgedGoals(goals, names, problem.goals)
            for goals in problem.variants.values()
        ]
        self._rounds: dict[int, dict[tuple[int, str, int], CellScore]] = {}

    def _take(self, answer: CellScore) -> None:
        self._rounds.setdefault(answer.iteration, {})[answer.individual, answer.scenario, answer.seed] = answer

    def objectives(self, number: int) -> Floats:
        """See `SearchAnswers`. A set belongs to the round of its last cell."""
        sets = {individual: cell.parameter_set for (individual, *_), cell in sorted(self._rounds.get(number, {}).items())}
        solutions = [self.ranking.get(parameter_set, compared=False) for parameter_set in sets.values()]
        return np.array([np.nan if each is None else each.objective for each in solutions], dtype=np.float64)

    def for_search(self, number: int, asked: AskedRound) -> tuple[list[CellAnswer]]:
        """Returns the answers in the order of asking."""
        told, names, seeds = self._rounds.pop(number), self._problem.scenarios, self._problem.least_replicates
        answers = []
        firsts = [cell for cell in asked.cells if (cell[2] - 1) % seeds == 0]
        for cell, (individual, scenario, first) in zip(cells_of(asked, seeds), firsts, strict=True):
            runs = [told[individual, names[scenario], seed] for seed in range(first, first + seeds)]
            answers.append(CellAnswer(cell, self.aim.of(over_seeds(runs)), failed=all(map(self.aim.is_failure, runs))))
        return (answers,)

    def forget(self, number: int) -> None:
        """Drops the answers of a round that is told to no search; the ranking keeps them."""
        self._rounds.pop(number, None)


class PopulationAnswers(SearchAnswers):
    """The answers of a generational optimizer: an individual keeps its answers until it is requested again."""

    def __init__(self, problem: CalibrationProblem) -> None:
        super().__init__(problem)
        self._runs: dict[tuple[int, str], dict[int, CellScore]] = {}
        """Answers of the newest round by individual, scenario and seed."""
        self._cells: list[dict[str, CellScore]] = [{} for _ in range(problem.search.population)]
        """By individual and scenario."""
        self._requested: set[int] = set()
        """Individuals of the current population with answers of their own."""
        self._by_set: dict[tuple[int, ...], dict[str, CellScore]] = {}
        """Answers by grid indices, with constraints only: after a repair, an individual may be an earlier set."""

    def _take(self, answer: CellScore) -> None:
        self._requested.add(answer.individual)
        runs = self._runs.setdefault((answer.individual, answer.scenario), {})
        if any(run.iteration != answer.iteration for run in runs.values()):
            runs.clear()
        runs[answer.seed] = answer
        self._cells[answer.individual][answer.scenario] = over_seeds([runs[seed] for seed in sorted(runs)])

    def settle(self, population: Indices) -> None:
        """Takes the answers of equal sets for the individuals that were not requested."""
        sets = list(map(tuple, population.tolist())) if self._problem.search_constraints else []
        for place in sorted(self._requested) if sets else ():
            self._by_set[sets[place]] = dict(self._cells[place])
        for place, indices in enumerate(sets):
            if place not in self._requested:
                self._cells[place] = dict(self._by_set.get(indices, {}))  # the budget may end within a round
        self._requested.clear()

    def objectives(self, number: int) -> Floats:
        """Returns the first objective of each individual, carried over or not."""
        del number
        return self._judged(self._cells)[0][:, 0]

    def for_search(self, number: int, asked: AskedRound) -> tuple[Floats, Floats]:
        """Returns the arguments of `Optimizer.tell`: higher objectives are better for every optimizer."""
        del number, asked
        signs = np.array([goal.sign for goal in self._goals.objectives], dtype=np.float64)
        amounts, violations = self._judged(self._cells)
        if self._goals.is_vector:
            return signs * amounts, violations
        ratings = amounts
        if self._goals.is_weighted_score:
            rated = [{name: replace(cell, score=cell.rating) for name, cell in cells.items()} for cells in self._cells]
            ratings, _ = self._judged(rated)
        return (signs * amounts)[:, 0], (signs * ratings)[:, 0]

    def _judged(self, sets: Sequence[Mapping[str, CellScore]]) -> tuple[Floats, Floats]:
        """Amounts, shape (n, m), and violations, shape (n,), of sets by their cells; NaN without a result."""
        amounts = np.full((len(sets), len(self._goals.objectives)), np.nan)
        violations = np.full(len(sets), np.nan)
        for individual, judgement in enumerate(self._goals.judge(sets)):
            if judgement is not None:
                amounts[individual] = judgement.amounts
                violations[individual] = judgement.violation
        return amounts, violations


def asked_rounds(connection: Connection, campaign: int, scenarios: Sequence[str]) -> list[AskedRound]:
    """Returns all rounds of a search by the cell."""
    places, cells = {name: place for place, name in enumerate(scenarios)}, dict[int, list[tuple[int, int, int]]]()
    for iteration, individual, scenario, seed in evaluations.places(connection, campaign, StageName.CALIBRATION):
        cells.setdefault(iteration, []).append((individual, places[scenario], seed))
    populations = [np.array(each, dtype=np.int64) for each in generations.populations(connection, campaign)]
    return [
        AskedRound(rows, np.ones(len(rows), dtype=np.bool_), cells.get(number, []), {})
        for number, rows in enumerate(populations)
    ]

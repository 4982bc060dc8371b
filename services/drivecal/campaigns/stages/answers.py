"""The answers of a search as it is told them, and the ranking of all sets so far."""

from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import replace
from operator import gt
from typing import Any

import numpy as np
from sqlalchemy import Connection

from drivecal.analysis.aims import JudgedGoals, WeightedScore
from drivecal.analysis.goals import valued_by
from drivecal.analysis.solutions import Ranking, over_seeds
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.stages.asking import AskedRound, cells_of
from drivecal.contracts.campaign import GenerationCounts
from drivecal.contracts.tables import Generation
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import CellScore
from drivecal.domain.parameters import Indices
from drivecal.plugins.ports import Floats
from drivecal.plugins.search import CellAnswer
from drivecal.storage import results


class SearchAnswers(ABC):
    """The answers of a search."""

    def __init__(self, problem: CalibrationProblem) -> None:
        self._problem, self._goals = problem, problem.goals
        self._sign = problem.bench.scale.sign
        wanted = problem.specification.replicates
        scale = problem.bench.scale
        self.ranking = Ranking(problem.weights, self._sign, problem.goals, scale.span, wanted)
        self.variants = {
            name: Ranking(goals.objectives[0].shares, self._sign, goals, scale.span, wanted)
            for name, goals in problem.variants.items()
        }
        """Rankings for each variant alone."""
        self._before = self._best_of_variants()

    def add(self, answers: Sequence[CellScore]) -> None:
        """Ranks answers."""
        for ranking in (self.ranking, *self.variants.values()):
            ranking.add(answers)

    def has_better_variant(self) -> bool:
        """Returns whether the answers that were read last give a variant a better set."""
        return any(map(gt, self._best_of_variants(), self._before))

    def _best_of_variants(self) -> list[tuple[float, float]]:
        bests = [ranking.best() for ranking in self.variants.values()]
        return [(-np.inf, 0.0) if best is None else (-best[0].violation, best[0].sign * best[0].objective) for best in bests]

    def take_in(self, connection: Connection, campaign: int, iterations: Collection[int]) -> None:
        """Reads the answers of iterations."""
        if not iterations:
            return
        self._before = self._best_of_variants()
        only = next(iter(iterations)) if len(iterations) == 1 else None
        taken = [answer for answer in self.read(connection, campaign, only) if answer.iteration in iterations]
        for answer in taken:
            self._take(answer)
        self.add(taken)

    def read(self, connection: Connection, campaign: int, iteration: int | None) -> list[CellScore]:
        """Returns the answered cells of one iteration, or of all, with the values that the goals need."""
        return list(results.answers(connection, campaign, StageName.CALIBRATION, iteration, valued=valued_by(self._goals)))

    def _worst(self, known: Floats) -> float | None:
        sign = self._sign if self._goals is None else self._goals.objectives[0].sign
        return float(sign * np.min(sign * known)) if known.size else None

    def figures(self, number: int, cells: GenerationCounts, objectives: Floats) -> Generation:
        """Returns the figures of a round with these counts and objectives, shape (n,), NaN without a result."""
        best, known = self.ranking.best(), objectives[~np.isnan(objectives)]
        return Generation(
            **cells.model_dump(),
            iteration=number,
            best=None if best is None else best[0].objective,
            rating=None if best is None else best[0].rating,
            mean=float(known.mean()) if known.size else None,
            minimum=self._worst(known),
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
        """Returns the arguments of `Asker.tell` for an answered round."""


class CellAnswers(SearchAnswers):
    """The answers of a search by the cell, by round."""

    def __init__(self, problem: CalibrationProblem) -> None:
        super().__init__(problem)
        names = tuple(problem.scenarios)
        scale = problem.bench.scale
        if problem.bench.is_random:  # the mean of rounded scores has no steps
            scale = replace(scale, step=None)
        self.aim = WeightedScore(problem.weights, scale) if problem.goals is None else JudgedGoals(problem.goals, names)
        self.aims_of_variants: list[WeightedScore | JudgedGoals] = [
            JudgedGoals(goals, names, problem.goals)
            if problem.goals is not None
            else WeightedScore({name: goals.objectives[0].shares.get(name, 0.0) for name in names}, scale)
            for goals in problem.variants.values()
        ]
        self._rounds: dict[int, dict[tuple[int, str, int], CellScore]] = {}

    def _take(self, answer: CellScore) -> None:
        self._rounds.setdefault(answer.iteration, {})[answer.individual, answer.scenario, answer.seed] = answer

    def objectives(self, number: int) -> Floats:
        """See `SearchAnswers`. A set belongs to the round of its last cell."""
        sets = {individual: cell.parameter_set for (individual, *_), cell in sorted(self._rounds.get(number, {}).items())}
        solutions = [self.ranking.get(parameter_set) for parameter_set in sets.values()]
        return np.array([np.nan if each is None else each.objective for each in solutions], dtype=np.float64)

    def for_search(self, number: int, asked: AskedRound) -> tuple[list[CellAnswer]]:
        """Returns the answers in the order of asking."""
        told, names, seeds = self._rounds.pop(number), self._problem.scenarios, self._problem.least_replicates
        answers = []
        firsts = [cell for cell in asked.cells if (cell[2] - 1) % seeds == 0]
        for cell, (individual, scenario, first) in zip(cells_of(asked, seeds), firsts, strict=True):
            runs = [told[individual, names[scenario], seed] for seed in range(first, first + seeds)]
            failed = all(run.score in {None, self._problem.bench.scale.failed} for run in runs)
            answers.append(CellAnswer(cell, self.aim.of(over_seeds(runs)), failed=failed))
        return (answers,)

    def forget(self, number: int) -> None:
        """Drops the answers of a round that is told to no search; the ranking keeps them."""
        self._rounds.pop(number, None)


class PopulationAnswers(SearchAnswers):
    """The answers of a generational optimizer: an individual keeps its answers until it is requested again."""

    def __init__(self, problem: CalibrationProblem, population: int) -> None:
        super().__init__(problem)
        shape = population, len(problem.scenarios)
        self._scores, self._ratings = np.full(shape, np.nan), np.full(shape, np.nan)
        self._runs: dict[tuple[int, str], dict[int, CellScore]] = {}
        """Answers of the newest round by individual, scenario and seed."""
        self._cells: list[dict[str, CellScore]] = [{} for _ in range(population)]
        """By individual and scenario, with goals only."""
        self._columns = {scenario: column for column, scenario in enumerate(problem.scenarios)}
        self._requested: set[int] = set()
        """Individuals of the current population with answers of their own."""
        self._by_set: dict[tuple[int, ...], tuple[Floats, Floats, dict[str, CellScore]]] = {}
        """Answers by grid indices, with constraints only: after a repair, an individual may be an earlier set."""

    def _take(self, answer: CellScore) -> None:
        self._requested.add(answer.individual)
        runs = self._runs.setdefault((answer.individual, answer.scenario), {})
        if any(run.iteration != answer.iteration for run in runs.values()):
            runs.clear()
        runs[answer.seed] = answer
        answer = over_seeds([runs[seed] for seed in sorted(runs)])
        cell = answer.individual, self._columns[answer.scenario]
        self._scores[cell] = np.nan if answer.score is None else answer.score
        self._ratings[cell] = np.nan if answer.rating is None else answer.rating
        if self._goals is not None:
            self._cells[answer.individual][answer.scenario] = answer

    def settle(self, population: Indices) -> None:
        """Takes the answers of equal sets for the individuals that were not requested."""
        sets = list(map(tuple, population.tolist())) if self._problem.search_constraints else []
        for place in sorted(self._requested) if sets else ():
            self._by_set[sets[place]] = self._scores[place].copy(), self._ratings[place].copy(), dict(self._cells[place])
        for place, indices in enumerate(sets):
            if place not in self._requested:
                scores, ratings, cells = self._by_set.get(indices, (np.nan, np.nan, {}))  # the budget may end within a round
                self._scores[place], self._ratings[place], self._cells[place] = scores, ratings, dict(cells)
        self._requested.clear()

    def objectives(self, number: int) -> Floats:
        """Returns the weighted score (Eq. 6), or the first objective, of each individual, carried over or not."""
        del number
        return self._weighted(self._scores) if self._goals is None else self._judged()[0][:, 0]

    def for_search(self, number: int, asked: AskedRound) -> tuple[Floats, Floats]:
        """Returns the arguments of `Optimizer.tell`: higher objectives are better for every optimizer."""
        del number, asked
        if self._goals is None:
            return self._sign * self._weighted(self._scores), self._sign * self._weighted(self._ratings)
        amounts, violations = self._judged()
        signed = amounts * np.array([goal.sign for goal in self._goals.objectives], dtype=np.float64)
        return (signed, violations) if self._goals.is_vector else (signed[:, 0], signed[:, 0])

    def _judged(self) -> tuple[Floats, Floats]:
        """Amounts, shape (population, m), and violations, shape (population,); NaN for individuals without a result."""
        if self._goals is None:
            raise ValueError("there are no goals")
        amounts = np.full((len(self._cells), len(self._goals.objectives)), np.nan)
        violations = np.full(len(self._cells), np.nan)
        for individual, cells in enumerate(self._cells):
            judgement = self._goals.judge(cells)
            if judgement is not None:
                amounts[individual] = judgement.amounts
                violations[individual] = judgement.violation
        return amounts, violations

    def _weighted(self, values: Floats) -> Floats:
        """Equation 6, shape (population,), added in the order of the scenarios; NaN for individuals without a result."""
        total = np.zeros(len(values))
        for column, weight in enumerate(self._problem.weights.values()):
            total += weight * values[:, column]
        return total

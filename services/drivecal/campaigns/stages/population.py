"""The answers of a search: those of the current population, by individual, and the ranking of all sets so far."""

from collections.abc import Collection

import numpy as np
from sqlalchemy import Connection

from drivecal.analysis.goals import valued_by
from drivecal.analysis.solutions import Ranking
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import CellScore
from drivecal.plugins.ports import Floats
from drivecal.storage import results


class PopulationAnswers:
    """Each individual keeps the answers of the iteration that requested it last."""

    def __init__(self, problem: CalibrationProblem, population: int) -> None:
        self._problem, self._goals = problem, problem.goals
        self._sign = problem.bench.scale.sign
        self.ranking = Ranking(problem.weights, self._sign, problem.goals)
        shape = population, len(problem.scenarios)
        self._scores, self._ratings = np.full(shape, np.nan), np.full(shape, np.nan)
        self._cells: list[dict[str, CellScore]] = [{} for _ in range(population)]
        """By individual and scenario, with goals only."""

    def take_in(self, connection: Connection, campaign: int, iterations: Collection[int]) -> None:
        """Reads the answers of iterations."""
        if not iterations:
            return
        columns = {scenario: column for column, scenario in enumerate(self._problem.scenarios)}
        only = next(iter(iterations)) if len(iterations) == 1 else None
        taken = [answer for answer in self.read(connection, campaign, only) if answer.iteration in iterations]
        for answer in taken:
            cell = answer.individual, columns[answer.scenario]
            self._scores[cell] = np.nan if answer.score is None else answer.score
            self._ratings[cell] = np.nan if answer.rating is None else answer.rating
            if self._goals is not None:
                self._cells[answer.individual][answer.scenario] = answer
        self.ranking.add(taken)

    def read(self, connection: Connection, campaign: int, iteration: int | None) -> list[CellScore]:
        """Returns the answered cells of one iteration, or of all, with the values that the goals need."""
        return list(results.answers(connection, campaign, StageName.CALIBRATION, iteration, valued=valued_by(self._goals)))

    def objectives(self) -> Floats:
        """The weighted score (Eq. 6), or the first objective, of each individual, shape (population,); NaN without a result."""
        return self._weighted(self._scores) if self._goals is None else self._judged()[0][:, 0]

    def worst(self, objectives: Floats) -> float | None:
        """The worst of `objectives`, shape (population,), by their direction; None without a result."""
        sign = self._sign if self._goals is None else self._goals.objectives[0].sign
        known = objectives[~np.isnan(objectives)]
        return float(sign * np.min(sign * known)) if known.size else None

    def for_optimizer(self) -> tuple[Floats, Floats]:
        """Returns the arguments of `Optimizer.tell`: higher objectives are better for every optimizer."""
        if self._goals is None:
            return self._sign * self._weighted(self._scores), self._sign * self._weighted(self._ratings)
        amounts, violations = self._judged()
        compared = np.array(
            [
                [
                    goal.compared(amount) if np.isfinite(amount) else np.nan
                    for goal, amount in zip(self._goals.objectives, row, strict=True)
                ]
                for row in amounts.tolist()
            ]
        )
        if self._goals.is_vector:
            return compared, violations
        return compared[:, 0], self._goals.objectives[0].sign * amounts[:, 0]

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
                # As in rankings: a set that meets a limit exactly keeps it, whatever rounding says.
                violations[individual] = judgement.violation if judgement.broken else 0.0
        return amounts, violations

    def _weighted(self, values: Floats) -> Floats:
        """Equation 6, shape (population,), added in the order of the scenarios; NaN for individuals without a result."""
        total = np.zeros(len(values))
        for column, weight in enumerate(self._problem.weights.values()):
            total += weight * values[:, column]
        return total

"""The best set and the baseline of a calibration, as they are stored and reported."""

from sqlalchemy import Connection

from drivecal.analysis.goals import EQUAL
from drivecal.analysis.solutions import EvaluatedSet
from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.stages.population import PopulationAnswers
from drivecal.campaigns.stages.stage import CampaignStage
from drivecal.contracts.campaign import Baseline, Best
from drivecal.domain.events import EventKind
from drivecal.domain.parameters import ParameterSet
from drivecal.storage import events
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import parameter_sets


class BestSetStage(CampaignStage):
    """A stage that ranks sets, and stores the best one and the baseline with their scores."""

    def __init__(
        self,
        database: Database,
        campaign: StoredCampaign,
        problem: CalibrationProblem,
        view: View,
        answers: PopulationAnswers,
    ) -> None:
        super().__init__(database, campaign, problem, view)
        self._answers = answers
        self._ranking = answers.ranking
        self._best, self._baseline = campaign.best, campaign.baseline

    def _describe_best(self, connection: Connection) -> None:
        best = self._ranking.best()
        if best is not None:
            solution, alternatives = best
            parameters = parameter_sets.load(connection, [solution.parameter_set])[solution.parameter_set]
            before = self._best
            self._best = Best(
                objective=solution.objective,
                parameters=parameters.floats,
                scores=dict(solution.scores),
                alternatives=alternatives,
                violation=solution.shares_violated,
            )
            gain = 0.0 if before is None else solution.sign * (self._best.objective - before.objective)
            goals = self._problem.goals  # the first set that keeps all constraints may be worse than the last that does not
            if before is None or gain > EQUAL or (goals is not None and goals.bounds and gain < -EQUAL):
                self._tell_best(connection, solution)
        unknown = self._baseline is None or self._baseline.objective is None
        self._remember_baseline(connection)
        if unknown and self._baseline is not None and self._baseline.objective is not None:
            events.add(connection, self._campaign.sequence, EventKind.BASELINE, self._baseline.model_dump())

    def _tell_best(self, connection: Connection, solution: EvaluatedSet) -> None:
        best = {} if self._best is None else self._best.model_dump()
        events.add(connection, self._campaign.sequence, EventKind.BEST, best | {"iteration": solution.iteration})

    def _remember_baseline(self, connection: Connection) -> None:
        baseline: ParameterSet | None = self._problem.baseline
        if baseline is None:
            return
        (number,) = parameter_sets.ensure(connection, [baseline])
        solution: EvaluatedSet | None = self._ranking.get(number)
        none_yet: dict[str, float | None] = dict.fromkeys(self._problem.scenarios)
        self._baseline = Baseline(
            objective=None if solution is None else solution.objective,
            parameters=baseline.floats,
            scores=none_yet if solution is None else dict(solution.scores),
            violation=0.0 if solution is None else solution.shares_violated,
        )

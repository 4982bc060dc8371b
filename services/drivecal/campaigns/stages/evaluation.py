"""A single evaluation: one parameter set in one or more scenarios, through the same table and the same workers as a campaign."""

from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.cells.rerating import rate_stored_runs
from drivecal.campaigns.resolve.problem import EvaluationProblem
from drivecal.campaigns.stages.stage import Round, Stage
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import RequestedCell
from drivecal.execution.scheduling.in_flight import Work
from drivecal.reduction.assignment import Policy
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database


class SingleEvaluation(Stage):
    """A parameter set in one or more scenarios. Answers come from equal parameter sets or a simulation, never by reuse; with time series,
    always from a new simulation."""

    name = StageName.CALIBRATION

    def __init__(self, database: Database, campaign: StoredCampaign, problem: EvaluationProblem, view: View) -> None:
        super().__init__(database, campaign, view)
        self._problem = problem
        self._asked = False

    @property
    def _at_most(self) -> int:
        return len(self._problem.bench.scenarios)

    def _resume(self) -> list[Work]:
        if not self._view.traced:
            rate_stored_runs(self._database, self._view, only=self._problem.parameter_set)
        return []

    def _ask(self) -> Round | None:
        if self._asked:
            return None
        self._asked = True
        bench, parameters = self._problem.bench, self._problem.parameter_set
        cells = [RequestedCell(0, scenario, parameters) for scenario in bench.scenarios]
        return Round(0, [(bench, cells)], Policy("off" if self._view.traced else "exact"))

    def _tell(self, asked: Round) -> None:
        """Does nothing: the rows hold the answers."""

"""A single evaluation: one parameter set in one or more scenarios, through the same table and the same workers as a campaign."""

from __future__ import annotations

from collections.abc import Sequence

from drivecal.campaigns.cells.cell_tracker import CellTracker, Work
from drivecal.campaigns.cells.planning import View, WantedCell, plan_cells
from drivecal.campaigns.cells.rerating import rate_stored_runs
from drivecal.campaigns.resolve.problem import EvaluationProblem
from drivecal.contracts.campaign import CellCounts, Progress, StageCellCounts
from drivecal.domain.campaigns import Stage
from drivecal.execution.scheduling.scheduler import Completed
from drivecal.reduction.assignment import Policy
from drivecal.storage import campaigns
from drivecal.storage.campaigns import Snapshot, StoredCampaign
from drivecal.storage.engine.database import Database


class SingleEvaluation:
    """Gives and takes work as `Calibration` does. Answers come from equal parameter sets or from a simulation, never by reuse; from a
    simulation of its own where its time series are wanted."""

    def __init__(self, database: Database, campaign: StoredCampaign, problem: EvaluationProblem, view: View) -> None:
        self._database = database
        self._campaign = campaign
        self._problem = problem
        self._view = view
        self._tracker = CellTracker(view, campaign.cells.model_dump(), campaign.simulating_seconds)
        self._loaded = False
        self.finished = False

    def work(self) -> list[Work]:
        """What to simulate; empty where answers are awaited or everything is `finished`."""
        work: list[Work] = []
        if not self._loaded:
            traced = self._view.traced
            if not traced:
                rate_stored_runs(self._database, self._view, only=self._problem.parameter_set)
            with self._database.transaction() as connection:
                if self._campaign.cells.proposed == 0:
                    wanted = [
                        WantedCell(0, scenario, self._problem.parameter_set) for scenario in self._problem.bench.scenarios
                    ]
                    cells = plan_cells(
                        connection, self._view, Policy("off" if traced else "exact"), Stage.CALIBRATION, 0, wanted
                    )
                    self._tracker.request(connection, cells, carried_over=0)
                work = self._tracker.load(connection, share_runs=not traced)
                campaigns.save_progress(connection, self._campaign.sequence, self._snapshot())
            self._loaded = True
        self.finished = self._tracker.waiting == 0
        return work

    def record(self, completed: Sequence[Completed]) -> list[Work]:
        """Writes results down."""
        with self._database.transaction() as connection:
            work = self._tracker.record(connection, completed)
            campaigns.save_progress(connection, self._campaign.sequence, self._snapshot())
        return work

    def _snapshot(self) -> Snapshot:
        counts = CellCounts(**self._tracker.counts)
        return Snapshot(
            stage=Stage.CALIBRATION,
            iteration=0,
            cells=counts,
            sensitivity_cells=StageCellCounts(),
            progress=Progress(done=counts.requested, total=counts.proposed),
            error_rate={},
            best=None,
            baseline=None,
            simulating_seconds=self._tracker.simulating_seconds,
            notes=(),
        )

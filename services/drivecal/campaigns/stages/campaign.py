"""A whole campaign: its stages one after the other, each taken up from the database."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from drivecal.campaigns.cells.cell_tracker import Work
from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.cells.rerating import note_of, rate_stored_runs
from drivecal.campaigns.resolve.maps import check_basis, stored_map
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.stages.calibration import Calibration
from drivecal.campaigns.stages.robustness import RobustnessStage
from drivecal.campaigns.stages.sensitivity import Sensitivity
from drivecal.campaigns.stages.validation import ValidationStage
from drivecal.domain.campaigns import Stage
from drivecal.execution.scheduling.scheduler import Completed
from drivecal.storage import campaigns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import influence_maps

AnyStage = Sensitivity | Calibration | RobustnessStage | ValidationStage


class StagedCampaign:
    """Gives and takes work as its stages do, in their order. The sensitivity stage is over when the campaign has an influence map."""

    def __init__(self, database: Database, campaign: StoredCampaign, problem: CalibrationProblem) -> None:
        self._database = database
        self._problem = problem
        self._view = View(
            campaign.sequence, campaign.watermark or 0, problem.bench, checked_certificates=problem.checked_certificates
        )
        self._begun = False
        self._sequence = campaign.sequence
        every = list(Stage)
        self._ahead = every if campaign.stage is None else every[every.index(campaign.stage) :]
        self.stage = campaign.stage
        """In which it is, None before the first."""
        self._stage: AnyStage | None = None

    @property
    def finished(self) -> bool:
        """Whether nothing is left to do."""
        return self._begun and self._stage is None

    def work(self) -> list[Work]:
        """What to simulate next; empty where answers are awaited or everything is `finished`."""
        if not self._begun:
            self._begin()
        while self._stage is not None:
            work = self._stage.work()
            if work or not self._stage.finished:
                return work
            self._stage = self._next(self._campaign())
        return []

    def _begin(self) -> None:
        rate_stored_runs(self._database, self._view)
        note = note_of(self._database, self._view)
        if note is not None:
            self._problem = replace(self._problem, notes=(*self._problem.notes, note))
        self._stage = self._next(self._campaign())
        self._begun = True

    def _campaign(self) -> StoredCampaign:
        with self._database.read() as connection:
            return campaigns.by_sequence(connection, self._sequence)

    def record(self, completed: Sequence[Completed]) -> list[Work]:
        """Writes results down; gives what is to be simulated instead."""
        return [] if self._stage is None else self._stage.record(completed)

    def _next(self, campaign: StoredCampaign) -> AnyStage | None:
        """The first wanted stage of those that are ahead; None where all are over."""
        while self._ahead:
            stage, *self._ahead = self._ahead
            if self._wants(campaign, stage):
                self.stage = stage
                return self._make(campaign, stage)
        return None

    def _wants(self, campaign: StoredCampaign, stage: Stage) -> bool:
        match stage:
            case Stage.SENSITIVITY:
                return campaign.influence_map_id is None and self._problem.analysis() is not None
            case Stage.CALIBRATION:
                return self._problem.optimization is not None
            case Stage.ROBUSTNESS:
                return self._problem.specification.robustness is not None
            case Stage.VALIDATION:
                return self._problem.specification.validation is not None

    def _make(self, campaign: StoredCampaign, stage: Stage) -> AnyStage:
        if stage is Stage.SENSITIVITY:
            return Sensitivity(self._database, campaign, self._problem, self._view)
        if stage is Stage.ROBUSTNESS:
            return RobustnessStage(self._database, campaign, self._problem, self._view)
        view = self._with_map(campaign)
        return (Calibration if stage is Stage.CALIBRATION else ValidationStage)(self._database, campaign, self._problem, view)

    def _with_map(self, campaign: StoredCampaign) -> View:
        if campaign.influence_map_id is None:
            return self._view
        with self._database.read() as connection:
            stored = influence_maps.get(connection, campaign.influence_map_id)
        check_basis(stored, self._problem)
        return replace(self._view, influence_map=stored_map(stored), influence_map_sequence=stored.sequence)

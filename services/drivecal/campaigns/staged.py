"""A whole campaign: its stages one after the other, each taken up from the database."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from drivecal.campaigns.calibration import Calibration
from drivecal.campaigns.ledger import Work
from drivecal.campaigns.maps import check_basis, stored_map
from drivecal.campaigns.planning import View
from drivecal.campaigns.problem import CalibrationProblem
from drivecal.campaigns.rerating import rate_stored_runs
from drivecal.campaigns.sensitivity import Sensitivity
from drivecal.execution.scheduler import Completed
from drivecal.storage import campaigns, influence_maps
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.database import Database


class StagedCampaign:
    """Gives and takes work as its stages do. The sensitivity stage is over when the campaign has an influence map."""

    def __init__(self, database: Database, campaign: StoredCampaign, problem: CalibrationProblem) -> None:
        self._database = database
        self._problem = problem
        self._view = View(campaign.sequence, campaign.watermark or 0, problem.bench)
        self._rated = False
        self._stage: Sensitivity | Calibration | None = self._next(campaign)

    @property
    def finished(self) -> bool:
        """Whether nothing is left to do."""
        return self._stage is None

    def work(self) -> list[Work]:
        """What to simulate next; empty where answers are awaited or everything is `finished`."""
        if not self._rated:
            rate_stored_runs(self._database, self._view)
            self._rated = True
        while self._stage is not None:
            work = self._stage.work()
            if work or not self._stage.finished:
                return work
            if isinstance(self._stage, Calibration):
                self._stage = None
            else:
                with self._database.read() as connection:
                    campaign = campaigns.by_sequence(connection, self._sequence)
                self._stage = self._next(campaign)
        return []

    def record(self, completed: Sequence[Completed]) -> list[Work]:
        """Writes results down; gives what is to be simulated instead."""
        return [] if self._stage is None else self._stage.record(completed)

    def _next(self, campaign: StoredCampaign) -> Sensitivity | Calibration | None:
        self._sequence = campaign.sequence
        if campaign.influence_map_id is None and self._problem.analysis() is not None:
            return Sensitivity(self._database, campaign, self._problem, self._view)
        if self._problem.optimization is None:
            return None
        view = self._view
        if campaign.influence_map_id is not None:
            with self._database.read() as connection:
                stored = influence_maps.get(connection, campaign.influence_map_id)
            check_basis(stored, self._problem)
            found = stored_map(stored)
            view = replace(view, influence_map=found, influence_map_sequence=stored.sequence)
        return Calibration(self._database, campaign, self._problem, view)

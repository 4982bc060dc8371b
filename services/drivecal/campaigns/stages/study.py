"""The frame of the stages after the calibration: pure studies are asked for cells, and told what became of them, round by round."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy import Connection

from drivecal.campaigns.cells.cell_tracker import CellTracker, Work
from drivecal.campaigns.cells.planning import View, WantedCell, plan_cells
from drivecal.campaigns.resolve.problem import Bench, CalibrationProblem
from drivecal.campaigns.stages.eta import EtaEstimate
from drivecal.contracts.campaign import StageCellCounts
from drivecal.domain.campaigns import Stage
from drivecal.domain.evaluations import CellScore
from drivecal.domain.events import EventKind
from drivecal.execution.scheduling.scheduler import Completed
from drivecal.reduction.assignment import Policy
from drivecal.storage import events, results, studies
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database


@dataclass(frozen=True, slots=True)
class Round:
    """Cells that a study asks for at a time, by the bench on which they are driven."""

    number: int
    cells: Sequence[tuple[Bench, Sequence[WantedCell]]]


class StudyStage(ABC):
    """Gives and takes work as `Calibration` does. Its cells are answered by equal parameter sets or simulated, never reused.

    All state is in the database after every call: a new object asks its study for the finished rounds again, tells it what became of them
    and goes on exactly as this one would.
    """

    stage: Stage

    def __init__(
        self,
        database: Database,
        campaign: StoredCampaign,
        problem: CalibrationProblem,
        view: View,
        counts: StageCellCounts,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._database = database
        self._campaign = campaign
        self._problem = problem
        self._view = replace(view, influence_map=None, influence_map_sequence=None)
        self._tracker = CellTracker(self._view, counts.model_dump(), campaign.simulating_seconds)
        self._eta = EtaEstimate(clock, counts.requested)
        self._round: Round | None = None
        self.finished = False

    @abstractmethod
    def _ask(self) -> Round | None:
        """The next round, with numbers from 0 on; None when the study is complete."""

    @abstractmethod
    def _tell(self, number: int, answers: Sequence[CellScore]) -> None:
        """What became of a round's cells."""

    @abstractmethod
    def _found(self) -> dict[str, Any]:
        """What the study found so far, JSON-ready."""

    @abstractmethod
    def _at_most(self) -> int:
        """How many cells the stage may ask for in all, as far as it is known."""

    def work(self) -> list[Work]:
        """What to simulate next; empty where answers are awaited or the stage is `finished`."""
        while not self._tracker.waiting and not self.finished:
            if self._round is not None:
                self._take(self._round.number)
            self._round = self._ask()
            if self._round is None:
                self._conclude()
                return []
            work = self._request(self._round)
            if work:
                return work
        return []

    def record(self, completed: Sequence[Completed]) -> list[Work]:
        """Writes results down, in one transaction with the counters that they change."""
        with self._database.transaction() as connection:
            work = self._tracker.record(connection, completed)
            self._save(connection)
        self._tracker.raise_if_refuted()
        return work

    def _take(self, number: int) -> None:
        with self._database.read() as connection:
            answers = list(results.answers(connection, self._campaign.sequence, self.stage, number))
        self._tell(number, answers)

    def _request(self, wanted: Round) -> list[Work]:
        """Commits the cells of a round before anything is dispatched; takes them up as they are where that was done already."""
        sequence = self._campaign.sequence
        policy = Policy("off" if self._problem.specification.reduction.mode == "off" else "exact")
        with self._database.transaction() as connection:
            if not results.has_iteration(connection, sequence, self.stage, wanted.number):
                if wanted.number == 0:
                    events.add(connection, sequence, EventKind.STAGE, {"stage": self.stage, "cells": self._at_most()})
                for bench, cells in wanted.cells:
                    view = replace(self._view, bench=bench)
                    planned = plan_cells(connection, view, policy, self.stage, wanted.number, cells)
                    self._tracker.request(connection, planned, carried_over=0)
                studies.save(connection, sequence, self.stage, self._found())
            elif not results.is_pending(connection, sequence, self.stage, wanted.number):
                return []  # it was over before this process began; what waits belongs to a later one
            benches = [bench for bench, _ in wanted.cells]
            work = self._tracker.load(connection, share_runs=policy.mode != "off", benches=benches)
            self._save(connection)
        return work

    def _conclude(self) -> None:
        with self._database.transaction() as connection:
            studies.save(connection, self._campaign.sequence, self.stage, {**self._found(), "complete": True})
            self._save(connection)
        self.finished = True

    def _save(self, connection: Connection) -> None:
        counts = StageCellCounts(**self._tracker.counts)
        studies.save_progress(
            connection,
            self._campaign.sequence,
            self.stage,
            iteration=None if self._round is None else self._round.number,
            cells=counts,
            progress=self._eta.progress(counts.requested, max(counts.proposed, self._at_most())),
            simulating_seconds=self._tracker.simulating_seconds,
        )

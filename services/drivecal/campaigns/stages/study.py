"""Stages after the calibration: pure studies that request cells round by round and store one document."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import Connection

from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.stages.stage import CampaignStage, Round
from drivecal.domain.evaluations import CellScore
from drivecal.domain.events import EventKind
from drivecal.storage import events, results, studies
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database


class StudyStage(CampaignStage):
    """A study of a campaign. Its cells are answered by equal parameter sets or simulated, never reused. `valued`: computes the values of
    a run that its answers need besides the score."""

    def __init__(
        self,
        database: Database,
        campaign: StoredCampaign,
        problem: CalibrationProblem,
        view: View,
        valued: results.Valued | None = None,
    ) -> None:
        super().__init__(database, campaign, problem, replace(view, influence_map=None, influence_map_sequence=None))
        self._valued = valued

    @abstractmethod
    def _take(self, number: int, answers: Sequence[CellScore]) -> None:
        """Takes the answers of a round."""

    @abstractmethod
    def _outcome(self) -> dict[str, Any]:
        """Returns the outcome of the study so far, JSON-ready."""

    def _tell(self, asked: Round) -> None:
        with self._database.read() as connection:
            answers = list(results.answers(connection, self._campaign.sequence, self.name, asked.number, valued=self._valued))
        self._take(asked.number, answers)

    def _announce(self, connection: Connection, asked: Round) -> None:
        if asked.number == 0:
            begun = {"stage": self.name, "cells": self._at_most}
            events.add(connection, self._campaign.sequence, EventKind.STAGE, begun)

    def _store(self, connection: Connection, asked: Round) -> None:
        del asked
        studies.save(connection, self._campaign.sequence, self.name, self._outcome())

    def _conclude(self) -> None:
        with self._database.transaction() as connection:
            studies.save(connection, self._campaign.sequence, self.name, {**self._outcome(), "complete": True})
            self._save(connection)

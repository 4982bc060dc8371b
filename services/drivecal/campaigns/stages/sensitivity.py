"""The sensitivity stage: has the runs of an analysis made, phase by phase, and turns what it finds into the campaign's influence map."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from sqlalchemy import Connection

from drivecal.campaigns.cells.cell_tracker import CellTracker, Work
from drivecal.campaigns.cells.planning import View, WantedCell, plan_cells
from drivecal.campaigns.resolve.maps import analysis_to_document, smallest_s_rel, stored_map
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.resolve.spaces import space_to_document
from drivecal.campaigns.stages.eta import EtaEstimate
from drivecal.contracts.campaign import StageCellCounts
from drivecal.domain.campaigns import Stage
from drivecal.domain.events import EventKind
from drivecal.domain.influence import InfluenceMap
from drivecal.domain.parameters import ParameterSet, text
from drivecal.execution.scheduling.scheduler import Completed
from drivecal.plugins.ports import Floats
from drivecal.reduction.assignment import Policy
from drivecal.reduction.keys import ReferenceKeys, billionths_matrix
from drivecal.sensitivity.analysis import Phase, SensitivityAnalysis
from drivecal.sensitivity.scenario import ScenarioInfluence
from drivecal.storage import campaigns, evaluations, events, results
from drivecal.storage.campaigns import Snapshot, StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import influence_maps

KEYS_AT_ONCE = 10_000


class Sensitivity:
    """Gives and takes work as `Calibration` does; a phase of the analysis is an iteration.

    Its runs are answered by equal parameter sets or simulated, never reused: the map that would allow it is what they are made for. A new
    object on the same campaign tells the analysis all finished phases again and goes on exactly as this one would.
    """

    stage = Stage.SENSITIVITY

    def __init__(
        self,
        database: Database,
        campaign: StoredCampaign,
        problem: CalibrationProblem,
        view: View,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        analysis = problem.analysis()
        if analysis is None:
            raise ValueError("the campaign has no sensitivity stage")
        self._database = database
        self._campaign = campaign
        self._problem = problem
        self._view = view
        self._analysis: SensitivityAnalysis = analysis
        self._tracker = CellTracker(view, campaign.sensitivity_cells.model_dump(), campaign.simulating_seconds)
        self._expected = problem.expected_runs()
        self._eta = EtaEstimate(clock, campaign.sensitivity_cells.requested)
        self._phase: Phase | None = None
        self._finished_phase: Phase | None = None
        self.finished = False

    def work(self) -> list[Work]:
        """What to simulate next; empty where answers are awaited or the stage is `finished`."""
        while not self._tracker.waiting and not self.finished:
            if self._phase is not None:
                self._tell(self._phase)
                self._finished_phase = self._phase
            self._phase = self._analysis.ask()
            if self._phase is None:
                self._make_map()
                self.finished = True
                return []
            work = self._request(self._phase)
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

    def _request(self, phase: Phase) -> list[Work]:
        """Commits the cells of a phase before anything is dispatched; takes them up as they are where that was done already."""
        with self._database.transaction() as connection:
            if not results.has_iteration(connection, self._campaign.sequence, Stage.SENSITIVITY, phase.number):
                self._tell_progress(connection)
                wanted = self._wanted(phase)
                cells = plan_cells(connection, self._view, self._policy, Stage.SENSITIVITY, phase.number, wanted)
                self._tracker.request(connection, cells, carried_over=0)
            work = self._tracker.load(connection, share_runs=self._policy.mode != "off")
            self._save(connection)
        return work

    def _tell_progress(self, connection: Connection) -> None:
        """The beginning of the stage, or the end of the phase before; in the transaction that follows it, so that it is told once."""
        sequence, done = self._campaign.sequence, self._finished_phase
        if done is not None:
            counts = StageCellCounts(**self._tracker.counts).model_dump(exclude={"proposed", "pending"})
            events.add(connection, sequence, EventKind.PHASE, {"phase": done.number, "name": done.name, **counts})
            return
        events.add(
            connection, sequence, EventKind.STAGE, {"stage": Stage.SENSITIVITY, "cells": self._expected.sensitivity_at_most}
        )
        for note in self._problem.notes:
            events.add(connection, sequence, EventKind.NOTE, {"text": note})

    @property
    def _policy(self) -> Policy:
        return Policy("off" if self._problem.specification.reduction.mode == "off" else "exact")

    def _wanted(self, phase: Phase) -> list[WantedCell]:
        sets: dict[int, list[ParameterSet]] = {}
        for points in phase.points.values():
            if id(points) not in sets:  # scenarios may share one array
                sets[id(points)] = self._problem.space.parameter_sets(points)
        return [
            WantedCell(individual, scenario, parameters)
            for scenario, points in phase.points.items()
            for individual, parameters in enumerate(sets[id(points)])
        ]

    def _tell(self, phase: Phase) -> None:
        scores: dict[str, Floats] = {scenario: np.full(len(points), np.nan) for scenario, points in phase.points.items()}
        with self._database.read() as connection:
            for answer in results.answers(connection, self._campaign.sequence, Stage.SENSITIVITY, phase.number):
                if answer.score is not None:
                    scores[answer.scenario][answer.individual] = answer.score
        self._analysis.tell(scores)

    def _make_map(self) -> None:
        """Stores the map, and gives the stage's runs their keys under it, so that they are references from the first population on."""
        found = self._analysis.result()
        with self._database.transaction() as connection:
            stored = influence_maps.insert(
                connection,
                name=self._campaign.name,
                source=self._campaign.id,
                driving_function=self._problem.bench.driving_function.name,
                parameters=space_to_document(self._problem.space.searched),
                scenarios=analysis_to_document(found),
                basis=self._basis(found),
            )
            influence_map = stored_map(stored)
            campaigns.set_influence_map(connection, self._campaign.sequence, stored.id)
            self._give_keys(connection, influence_map)
            self._tell_progress(connection)
            told = {"id": stored.id, "influential": _influential(influence_map)}
            events.add(connection, self._campaign.sequence, EventKind.INFLUENCE_MAP, told)

    def _give_keys(self, connection: Connection, influence_map: InfluenceMap) -> None:
        cells: dict[str, list[tuple[int, ParameterSet]]] = {}
        for number, scenario, parameters in results.donors(connection, self._campaign.sequence, Stage.SENSITIVITY):
            cells.setdefault(scenario, []).append((number, parameters))
        for scenario, listed in cells.items():
            keys = ReferenceKeys(influence_map, scenario, self._view.names)
            for start in range(0, len(listed), KEYS_AT_ONCE):
                portion = listed[start : start + KEYS_AT_ONCE]
                made = keys.keys(billionths_matrix([parameters for _, parameters in portion]))
                evaluations.set_reference_keys(
                    connection, {number: key for (number, _), key in zip(portion, made, strict=True)}
                )

    def _basis(self, found: Mapping[str, ScenarioInfluence]) -> dict[str, Any]:
        """What the map rests on, so that it is not used for something else, and how fine its measures are."""
        bench, space = self._problem.bench, self._problem.space
        return {
            "sensitivity": self._problem.specification.model_dump(mode="json")["sensitivity"],
            "fixed": {name: text(value) for name, value in space.fixed.items()},
            "setups": {scenario: setup.fingerprint for scenario, setup in bench.setups.items()},
            "evaluator": bench.evaluator_id,
            "smallest_s_rel": smallest_s_rel(found),
            "runs": self._tracker.counts.get("requested", 0),
            "simulated": self._tracker.counts.get("simulated", 0),
        }

    def _save(self, connection: Connection) -> None:
        counts = StageCellCounts(**self._tracker.counts)
        phase = None if self._phase is None else self._phase.number
        campaigns.save_progress(
            connection,
            self._campaign.sequence,
            Snapshot(
                stage=Stage.SENSITIVITY,
                iteration=phase,
                cells=self._campaign.cells,
                sensitivity_cells=counts,
                progress=self._eta.progress(counts.requested, max(self._expected.sensitivity, counts.proposed)),
                error_rate={},
                best=None,
                baseline=None,
                simulating_seconds=self._tracker.simulating_seconds,
                notes=self._problem.notes,
            ),
        )


def _influential(influence_map: InfluenceMap) -> dict[str, list[str]]:
    """The parameters that matter, by scenario."""
    return {
        scenario: [name for name, influence in parameters.items() if influence.influential]
        for scenario, parameters in influence_map.scenarios.items()
    }

"""The sensitivity stage: simulates the runs of an analysis by phase, and makes the campaign's influence map from them."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from sqlalchemy import Connection

from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.resolve.maps import analysis_to_document, basis_of, smallest_s_rel, stored_map
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.resolve.spaces import space_to_document
from drivecal.campaigns.stages.replication import SeededBenches
from drivecal.campaigns.stages.stage import Round, Stage, exact_policy
from drivecal.contracts.campaign import CellCounts
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import RequestedCell
from drivecal.domain.events import EventKind
from drivecal.domain.influence import InfluenceMap
from drivecal.domain.parameters import ParameterSet
from drivecal.plugins.ports import Floats
from drivecal.reduction.keys import ReferenceKeys, billionths_matrix
from drivecal.sensitivity.analysis import Phase, SensitivityAnalysis
from drivecal.sensitivity.scenario import ScenarioInfluence
from drivecal.storage import campaigns, evaluations, events, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import influence_maps

KEYS_AT_ONCE = 10_000


class Sensitivity(Stage):
    """The analysis of a campaign; each phase is a round, and its intervals are several if they are chosen sequentially.

    Each sample of a random simulator has a seed: an effect is a step under one seed, its statistics those over seeds. Runs are answered by
    equal parameter sets or simulated, never reused: reuse needs the map that they produce.
    """

    name = StageName.SENSITIVITY
    _problem: CalibrationProblem

    def __init__(self, database: Database, campaign: StoredCampaign, problem: CalibrationProblem, view: View) -> None:
        analysis = problem.analysis()
        if analysis is None:
            raise ValueError("the campaign has no sensitivity stage")
        super().__init__(database, campaign, problem, view)
        self._analysis: SensitivityAnalysis = analysis
        self._benches = SeededBenches(problem.bench)
        self._expected = problem.expected_runs()
        self._phase: Phase | None = None
        self._finished_phase: tuple[Phase, CellCounts] | None = None
        """The phase whose end is no event yet, with the counts at its end: cells of the next one may be answered at once."""

    @property
    def _at_most(self) -> int:
        is_early = self._phase is None or self._phase.name == "intervals"
        return self._expected.sensitivity if is_early else 0  # later phases leave no interval to be run

    def _ask(self) -> Round | None:
        self._phase = self._analysis.ask()
        if self._phase is None:
            return None
        return Round(self._phase.number, self._benches.with_cells(self._wanted(self._phase)), exact_policy(self._problem))

    def _store(self, connection: Connection, asked: Round) -> None:
        del asked
        self._record_progress(connection)

    def _record_progress(self, connection: Connection) -> None:
        """Adds the event of the stage's start or of the previous phase's end, once: in the transaction that follows it."""
        sequence = self._campaign.sequence
        if self._finished_phase is not None:
            done, counts = self._finished_phase
            data = {"phase": done.number, "name": done.name, **counts.model_dump(exclude={"proposed", "pending"})}
            events.add(connection, sequence, EventKind.PHASE, data)
            return
        events.add(connection, sequence, EventKind.STAGE, {"stage": self.name, "cells": self._expected.sensitivity_at_most})
        for note in self._problem.notes:
            events.add(connection, sequence, EventKind.NOTE, {"text": note})

    def _wanted(self, phase: Phase) -> list[RequestedCell]:
        sets: dict[int, list[ParameterSet]] = {}
        for points in phase.points.values():
            if id(points) not in sets:  # scenarios may share one array
                sets[id(points)] = self._problem.space.parameter_sets(points)
        return [
            RequestedCell(number, scenario, parameters, seed=self._problem.bench.seed_of(sample))
            for scenario, points in phase.points.items()
            for number, (parameters, sample) in enumerate(zip(sets[id(points)], phase.samples[scenario].tolist(), strict=True))
        ]

    def _tell(self, asked: Round) -> None:
        phase = self._phase
        if phase is None:
            raise RuntimeError(f"phase {asked.number} was not asked for")
        scores: dict[str, Floats] = {scenario: np.full(len(points), np.nan) for scenario, points in phase.points.items()}
        with self._database.read() as connection:
            for answer in results.answers(connection, self._campaign.sequence, self.name, phase.number):
                if answer.score is not None:
                    scores[answer.scenario][answer.individual] = answer.score
        self._analysis.tell(scores)
        self._finished_phase = phase, CellCounts(**self._tracker.counts)

    def _conclude(self) -> None:
        """Stores the map, and the reference keys of the stage's runs under it, so that they are references for the first population."""
        analysis = self._analysis.result()
        with self._database.transaction() as connection:
            stored = influence_maps.insert(
                connection,
                name=self._campaign.name,
                source=self._campaign.id,
                driving_function=self._problem.bench.function,
                parameters=space_to_document(self._problem.space.searched),
                scenarios=analysis_to_document(analysis),
                basis=self._basis(analysis),
            )
            influence_map = stored_map(stored)
            campaigns.set_influence_map(connection, self._campaign.sequence, stored.id)
            self._give_keys(connection, influence_map)
            self._record_progress(connection)
            influential = {
                scenario: [name for name, influence in parameters.items() if influence.influential]
                for scenario, parameters in influence_map.scenarios.items()
            }
            data = {"id": stored.id, "influential": influential}
            events.add(connection, self._campaign.sequence, EventKind.INFLUENCE_MAP, data)

    def _give_keys(self, connection: Connection, influence_map: InfluenceMap) -> None:
        cells: dict[str, list[tuple[int, ParameterSet]]] = {}
        for number, scenario, parameters in results.donors(connection, self._campaign.sequence, StageName.SENSITIVITY):
            cells.setdefault(scenario, []).append((number, parameters))
        for scenario, listed in cells.items():
            keys = ReferenceKeys(influence_map, scenario, self._view.names)
            for start in range(0, len(listed), KEYS_AT_ONCE):
                portion = listed[start : start + KEYS_AT_ONCE]
                made = keys.keys(billionths_matrix([parameters for _, parameters in portion]))
                keyed = {number: key for (number, _), key in zip(portion, made, strict=True)}
                evaluations.store(connection, "reference_key", keyed)

    def _basis(self, analysis: Mapping[str, ScenarioInfluence]) -> dict[str, Any]:
        """The conditions of the map, and the resolution of its measures."""
        return basis_of(self._problem) | {
            "smallest_s_rel": smallest_s_rel(analysis),
            "runs": self._tracker.counts.get("requested", 0),
            "simulated": self._tracker.counts.get("simulated", 0),
        }

    def _snapshot(self, connection: Connection) -> StoredCampaign:
        return replace(super()._snapshot(connection), notes=(*self._problem.notes, *self._score_notes()))

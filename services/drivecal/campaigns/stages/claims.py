"""The first stage of a campaign whose problem says what runs of its earlier versions mean: simulates a sample of them again."""

import sys
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

from drivecal.campaigns.cells.earlier import EarlierVersion, answers_of, bench_of, present_version, sample
from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.cells.rerating import rate_stored_runs
from drivecal.campaigns.resolve.bench import Bench
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.stages.stage import Round, Stage
from drivecal.contracts.assignments import value_text
from drivecal.contracts.specification import ReductionSpecification
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import InvalidInputError, NoResultError, Problem
from drivecal.domain.evaluations import RequestedCell
from drivecal.domain.parameters import ParameterSet
from drivecal.domain.scales import score_text
from drivecal.storage import campaigns, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import runs


def checkable(database: Database, view: View, problem: CalibrationProblem) -> list[tuple[EarlierVersion, str, ParameterSet]]:
    """Rates the stored runs that claims speak of, and returns a sample that checks them; empty if none answers a cell."""
    for version in view.earlier:
        rate_stored_runs(database, replace(view, bench=bench_of(version, view.bench)))
    return database.query(sample, view.bench, view.earlier, problem.space, view.watermark)


class ClaimCheck(Stage):
    """One round: stored cells of earlier versions, simulated again with the claimed values. A difference ends the campaign."""

    name = StageName.CLAIMS

    def __init__(self, database: Database, campaign: StoredCampaign, problem: CalibrationProblem, view: View) -> None:
        super().__init__(database, campaign, problem, replace(view, earlier=()))
        self._sample = [(scenario, parameters) for _, scenario, parameters in checkable(database, view, problem)]
        self._answered, self._versions = not self._sample, view.earlier

    @property
    def _at_most(self) -> int:
        return len(self._sample)

    def _ask(self) -> Round | None:
        if self._answered:
            return None
        cells = [RequestedCell(number, *cell) for number, cell in enumerate(self._sample)]
        return Round(0, [(self._view.bench, cells)], ReductionSpecification(mode="exact"))

    def _tell(self, asked: Round) -> None:
        """Compares the sample. Raises InvalidInputError naming the claims of a cell that differs, and NoResultError without results."""
        del asked
        self._answered = True
        compared, faults = compare(self._database, self._view, self._versions, self._sample)
        if faults:
            raise InvalidInputError(*faults)
        if self._sample and not compared:
            claims = ", ".join(dict.fromkeys(claim for version in self._versions for claim in version.claims))
            raise NoResultError(f"no cell of the check of {claims} gave a result{self._causes()}")


def compare(
    database: Database, view: View, versions: Sequence[EarlierVersion], cells: Collection[tuple[str, ParameterSet]]
) -> tuple[int, list[Problem]]:
    """Compares present runs of cells with the runs of earlier versions that claims make their equals; returns how many pairs there are, and
    the claims of the first pair that differs: in any measure if the simulator is deterministic, else in the score."""
    compared, bench = 0, view.bench
    with database.read() as connection:
        own = answers_of(connection, bench, [present_version(bench)], cells, sys.maxsize)
        for version in versions:
            stored = answers_of(connection, bench, [version], own, view.watermark)
            made = [*stored.values(), *(own[cell] for cell in stored)]
            values = runs.values_of(connection, {run.run for run in made})
            for cell, other in stored.items():
                difference = _difference(bench, *((run.score, *values[run.run]) for run in (own[cell], other)))
                if difference is not None:
                    maker = campaigns.by_sequence(connection, results.by_id(connection, other.evaluation).campaign_sequence)
                    made_by = f"evaluation {other.evaluation} of {maker.id}"
                    return compared, [_refusal(claim, *cell, made_by, difference) for claim in version.claims]
            compared += len(stored)
    return compared, []


def _difference(bench: Bench, now: Sequence[Any], then: Sequence[Any]) -> str | None:
    """Returns how a new run differs from a stored one; each has a score, measures and a failure."""
    exact, values = bench.bundle.manifest.simulator.deterministic, {bench.score: (now[0], then[0])}
    if exact:
        values |= {name: (value, then[1][name]) for name, value in now[1].items() if name in then[1]}
    for name, pair in values.items():
        if None not in pair and (pair[0] != pair[1] if exact else bench.scale.is_wrong(pair[0] - pair[1])):
            new, old = map(repr if score_text(pair[0]) == score_text(pair[1]) else score_text, pair)
            return f"has {name} {new} now, and {old} in the stored run"
    return f"fails {'no more' if now[2] is None else 'now'}" if exact and (now[2] is None) != (then[2] is None) else None


def _refusal(claim: str, scenario: str, parameters: ParameterSet, made_by: str, difference: str) -> Problem:
    values = " ".join(f"{name}={value_text(value)}" for name, value in parameters.floats.items())
    message = f"{scenario} with {values} {difference} ({made_by})"
    return Problem(claim, message, "correct the value in problem.yaml or leave it out, and push again")

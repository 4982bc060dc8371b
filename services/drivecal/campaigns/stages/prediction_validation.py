"""Validation of a campaign's released predictions: some are simulated and compared."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from sqlalchemy import Connection

from drivecal.analysis.replicates import rate_bounds
from drivecal.analysis.validation import compared
from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.resolve.resolved_spec import resolved_spec, specification_of
from drivecal.campaigns.stages.stage import Round, StudyStage, ended_source, exact_policy
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.evaluations import CellScore, Outcome, RequestedCell
from drivecal.reduction.lots import draw
from drivecal.storage import campaigns, lots, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.results import StoredEvaluation

FIELD = "validation.of"


def check_predictions(connection: Connection, problem: CalibrationProblem) -> None:
    """Raises InvalidInputError if `validation.of` names no ended campaign with released predictions, or one of another bench."""
    wanted = problem.specification.validation
    if wanted is None or wanted.of is None:
        return
    source = ended_source(connection, wanted.of, FIELD)
    if source.cells.predicted == 0:
        raise InvalidInputError(Problem(FIELD, f"campaign {wanted.of} released no predictions", "name one with predictions"))
    theirs = resolved_spec(source)
    own = {name: setup.fingerprint for name, setup in problem.bench.setups.items()}
    if theirs.evaluator != problem.bench.evaluator_id or any(theirs.setups.get(name) != own[name] for name in own):
        message = "its catalogue, driving function, vehicle or evaluator is another one, or has another version"
        raise InvalidInputError(Problem(FIELD, message, "give the same, as `drivecal validate ID --predicted` does"))


def runs_at_most(connection: Connection, problem: CalibrationProblem) -> int:
    """Returns how many released predictions are simulated at most; 0 if the campaign validates none."""
    wanted = problem.specification.validation
    if wanted is None or wanted.of is None:
        return 0
    released = campaigns.get(connection, wanted.of).released
    return sum(min(wanted.samples, released[name].predicted) for name in problem.scenarios if name in released)


class PredictionValidation(StudyStage):
    """One round: the released predictions of a campaign, or `samples` of them in each scenario, drawn by `seed`."""

    name = StageName.VALIDATION

    def __init__(self, database: Database, campaign: StoredCampaign, problem: CalibrationProblem, view: View) -> None:
        super().__init__(database, campaign, problem, view)
        wanted = problem.specification.validation
        if wanted is None or wanted.of is None:
            raise ValueError("the campaign has no predictions to validate")
        with database.read() as connection:
            source = campaigns.get(connection, wanted.of)
            stored = results.released(connection, source.sequence)
            done = [lot for lot in lots.of_campaign(connection, source.sequence, Outcome.PREDICTED) if lot.verdict is not None]
        self._inspected = {name: sum(lot.size for lot in done if lot.scenario == name) for name in problem.scenarios}
        self._reduction = specification_of(source).reduction
        self._released = {name: [cell for cell in stored if cell.scenario == name] for name in problem.scenarios}
        self._drawn = {name: _drawn(cells, wanted.samples, wanted.seed) for name, cells in self._released.items()}
        self._differences: Mapping[str, Sequence[float]] | None = None

    @property
    def _at_most(self) -> int:
        return sum(map(len, self._drawn.values()))

    def _ask(self) -> Round | None:
        if self._differences is not None:
            return None
        cells = [
            RequestedCell(number, scenario, cell.parameters)
            for scenario, drawn in self._drawn.items()
            for number, cell in enumerate(drawn)
        ]
        return Round(0, [(self._problem.bench, cells)], exact_policy(self._problem)) if cells else None

    def _take(self, number: int, answers: Sequence[CellScore]) -> None:
        del number
        differences: dict[str, list[float]] = {scenario: [] for scenario in self._drawn}
        for answer in answers:
            predicted = self._drawn[answer.scenario][answer.individual].score
            if answer.score is not None and predicted is not None:
                differences[answer.scenario].append(predicted - answer.score)
        self._differences = differences

    def _outcome(self) -> dict[str, Any]:
        return {"items": [self._row(scenario) for scenario in self._drawn], "notes": []}

    def _row(self, scenario: str) -> dict[str, Any]:
        differences = [] if self._differences is None else self._differences[scenario]
        unanswered = 0 if self._differences is None else len(self._drawn[scenario]) - len(differences)
        scale = self._problem.bench.scale
        counts = compared(np.array(differences, dtype=np.float64), scale)
        tolerance = self._reduction.tolerance_on(scale) + scale.grain
        lower, upper = rate_bounds(counts["wrong"], counts["compared"]) if differences else (None, None)
        drawn, beyond = len(self._drawn[scenario]), unanswered + sum(abs(difference) > tolerance for difference in differences)
        return {
            "scenario": scenario,
            "reducible": 0,
            "effects": 0,
            "covered": 0,
            "drawn": drawn,
            "bases": drawn,
            "references": 1,
            "released": len(self._released[scenario]),
            "inspected": self._inspected[scenario],
            "beyond": beyond,
            "beyond_lower_95": rate_bounds(beyond, drawn)[0] if drawn and self._differences is not None else None,
            "limit": self._reduction.limit,
            **counts,
            "lower_95": lower,
            "upper_95": upper,
        }


def _drawn(cells: Sequence[StoredEvaluation], samples: int, seed: int) -> list[StoredEvaluation]:
    identities = [str(cell.id).encode() for cell in cells]
    return [cells[place] for place in draw(identities, min(samples, len(cells)), str(seed).encode())]

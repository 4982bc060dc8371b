"""The first stage of a campaign whose problem says what runs of its earlier versions mean: simulates a sample of them again."""

from collections.abc import Mapping
from dataclasses import replace

from drivecal.campaigns.cells.earlier import EarlierCell, bench_of, sample
from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.cells.rerating import rate_stored_runs
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.stages.stage import Round, Stage
from drivecal.contracts.assignments import value_text
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import InvalidInputError, NoResultError, Problem
from drivecal.domain.evaluations import CellScore, RequestedCell
from drivecal.domain.scales import told
from drivecal.reduction.assignment import Policy
from drivecal.storage import campaigns, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import runs


def checkable(database: Database, view: View, problem: CalibrationProblem) -> list[EarlierCell]:
    """Rates the stored runs that claims speak of, and returns a sample that checks them; empty if none answers a cell."""
    for version in view.earlier:
        rate_stored_runs(database, replace(view, bench=bench_of(version, view.bench)))
    with database.read() as connection:
        return sample(connection, view.bench, view.earlier, problem.space, view.watermark)


class ClaimCheck(Stage):
    """One round: stored cells of earlier versions, simulated again with the claimed values. A difference ends the campaign."""

    name = StageName.CLAIMS

    def __init__(self, database: Database, campaign: StoredCampaign, problem: CalibrationProblem, view: View) -> None:
        super().__init__(database, campaign, replace(view, earlier=()))
        self._sample = checkable(database, view, problem)
        self._answered = not self._sample

    @property
    def _at_most(self) -> int:
        return len(self._sample)

    def _ask(self) -> Round | None:
        if self._answered:
            return None
        cells = [RequestedCell(number, cell.scenario, cell.parameters) for number, cell in enumerate(self._sample)]
        return Round(0, [(self._view.bench, cells)], Policy("exact"))

    def _tell(self, asked: Round) -> None:
        """Compares the sample. Raises InvalidInputError naming the claims of a cell that differs, and NoResultError without results."""
        del asked
        self._answered = True
        with self._database.read() as connection:
            before = runs.values_of(connection, [cell.run.evaluation for cell in self._sample])
            answers = [
                (self._sample[answer.individual], answer)
                for answer in results.answers(
                    connection, self._campaign.sequence, self.name, valued=lambda measures, *_: _finite(measures)
                )
                if answer.score is not None
            ]
        if self._sample and not answers:
            claims = ", ".join(dict.fromkeys(claim for cell in self._sample for claim in cell.version.claims))
            raise NoResultError(f"no cell of the check of {claims} gave a result{self._causes()}")
        for cell, answer in answers:
            difference = self._difference(cell, answer, *before[cell.run.evaluation])
            if difference is not None:
                with self._database.read() as connection:
                    number = results.by_id(connection, cell.run.evaluation).campaign_sequence
                    made_by = campaigns.by_sequence(connection, number).id
                raise InvalidInputError(*(_refusal(claim, cell, made_by, difference) for claim in cell.version.claims))

    def _difference(
        self, cell: EarlierCell, answer: CellScore, measures: Mapping[str, float | None], failure: str | None
    ) -> str | None:
        """Returns how a new run differs from the stored one: in any measure if the simulator is deterministic, else in the score."""
        bench = self._view.bench
        values = {bench.score: (answer.score, cell.run.score)}
        if bench.bundle.manifest.simulator.deterministic:
            stored = _finite(measures)
            values |= {name: (value, stored[name]) for name, value in answer.values.items() if name in stored}
            wrong = [name for name, (now, then) in values.items() if now != then]
            if not wrong and answer.failed != (failure is not None):
                return f"fails {'now' if answer.failed else 'no more'}"
        else:
            wrong = [bench.score] if bench.scale.is_wrong((answer.score or 0.0) - cell.run.score) else []
        for name in wrong:
            now, then = map(told if told(values[name][0]) != told(values[name][1]) else repr, values[name])
            return f"has {name} {now} now, and {then} in the stored run"
        return None


def _finite(measures: Mapping[str, float | None]) -> dict[str, float]:
    return {name: value for name, value in measures.items() if value is not None}


def _refusal(claim: str, cell: EarlierCell, campaign: str, difference: str) -> Problem:
    values = " ".join(f"{name}={value_text(value)}" for name, value in cell.parameters.floats.items())
    message = f"{cell.scenario} with {values} {difference} (evaluation {cell.run.evaluation} of {campaign})"
    return Problem(claim, message, "correct the value in problem.yaml or leave it out, and push again")

"""Inspects lots of predicted cells: draws their samples, compares these with the predictions, and releases or rejects the lots.

The rows are authoritative. A sample is drawn after the predictions are committed, by the campaign's secret, so that a crash changes
neither sample nor verdict.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from sqlalchemy import Connection

from drivecal.domain.evaluations import Outcome
from drivecal.reduction.lots import SamplingPlan, draw
from drivecal.reduction.prediction import ROUNDING
from drivecal.storage import evaluations, lots
from drivecal.storage.lots import LotVerdict, StoredLot
from drivecal.storage.results import StoredEvaluation


@dataclass(slots=True)
class _OpenLot:
    """A lot without a verdict: `sampled` cells wait for their simulation, `members` for the verdict."""

    lot: StoredLot
    errors: int = 0
    sampled: set[int] = field(default_factory=set)
    members: dict[int, StoredEvaluation] = field(default_factory=dict)

    @property
    def plan(self) -> SamplingPlan:
        return SamplingPlan(self.lot.size, self.lot.sample, self.lot.acceptance)


class Inspection:
    """The open lots of one campaign."""

    def __init__(self, campaign: int) -> None:
        self._campaign = campaign
        self._open: dict[int, _OpenLot] = {}

    def load(self, connection: Connection, pending: Mapping[int, StoredEvaluation]) -> dict[int, StoredEvaluation]:
        """Loads the lots without a verdict from committed rows, draws missing samples, and returns the drawn cells by id."""
        waiting = [cell for cell in pending.values() if cell.lot is not None]
        self._open = {}
        if not waiting:
            return {}
        stored = {lot.id: lot for lot in lots.of_campaign(connection, self._campaign) if lot.size and lot.verdict is None}
        errors = lots.errors_so_far(connection, self._campaign, list(stored))
        self._open = {number: _OpenLot(lot, errors.get(number, 0)) for number, lot in stored.items()}
        for cell in waiting:
            if cell.lot in self._open and cell.sampled:
                self._open[cell.lot].sampled.add(cell.id)
            elif cell.lot in self._open:
                self._open[cell.lot].members[cell.id] = cell
        drawn: dict[int, StoredEvaluation] = {}
        for lot in self._open.values():
            if len(lot.members) == lot.lot.size:
                drawn |= self._draw(connection, lot)
        evaluations.draw_sample(connection, list(drawn))
        return drawn

    def _draw(self, connection: Connection, lot: _OpenLot) -> dict[int, StoredEvaluation]:
        cells = sorted(lot.members.values(), key=lambda cell: cell.individual)
        identities = [f"{cell.scenario}:{cell.iteration}:{cell.individual}".encode() for cell in cells]
        chosen = [cells[place] for place in draw(identities, lot.plan.sample, lots.secret(connection, self._campaign))]
        for cell in chosen:
            del lot.members[cell.id]
            lot.sampled.add(cell.id)
        return {cell.id: replace(cell, plan=Outcome.SIMULATED, sampled=True) for cell in chosen}

    def compare(self, cell: StoredEvaluation, score: float | None) -> bool | None:
        """Takes a sampled cell's simulated score, None without a result, and returns whether the prediction was right; None for other
        cells."""
        lot = self._open.get(cell.lot or 0)
        if not cell.sampled or lot is None or cell.predicted_score is None:
            return None
        right = score is not None and abs(score - cell.predicted_score) <= lot.lot.tolerance + ROUNDING
        lot.sampled.discard(cell.id)
        lot.errors += not right
        return right

    def conclude(self, connection: Connection) -> tuple[list[StoredEvaluation], list[StoredEvaluation]]:
        """Stores the verdicts of lots with a complete sample, and returns the cells to release and those to simulate.

        A verdict waits for the whole sample even if it cannot change any more, so that it does not depend on the workers' timing.
        """
        released: list[StoredEvaluation] = []
        rejected: list[StoredEvaluation] = []
        complete = {number: lot for number, lot in self._open.items() if not lot.sampled}
        for number, lot in complete.items():
            (released if lot.plan.releases(lot.errors) else rejected).extend(lot.members.values())
            del self._open[number]
        verdicts = {
            number: (LotVerdict.RELEASED if lot.plan.releases(lot.errors) else LotVerdict.REJECTED, lot.errors)
            for number, lot in complete.items()
        }
        lots.conclude(connection, verdicts)
        return released, rejected

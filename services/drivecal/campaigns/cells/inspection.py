"""Inspects lots of predicted and of reused cells: draws their samples, compares these with the predictions or the references, and releases
or rejects the lots.

The rows are authoritative. A sample is drawn after the lot is committed, by the campaign's secret, so that a crash changes neither sample
nor verdict.
"""

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from sqlalchemy import Connection

from drivecal.analysis.validation import error_rates
from drivecal.campaigns.cells.planning import View
from drivecal.contracts.campaign import ErrorRate
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import INSPECTED, Outcome, Purpose, RequestedCell
from drivecal.domain.events import EventKind
from drivecal.domain.scales import Scale
from drivecal.reduction.assignment import expected_error_rate
from drivecal.reduction.lots import SamplingPlan, best_plan, draw, most_released
from drivecal.storage import audits, evaluations, events, lots
from drivecal.storage.evaluations import AnsweredCell
from drivecal.storage.lots import LotVerdict, NewLot, StoredLot
from drivecal.storage.results import StoredEvaluation


@dataclass(slots=True)
class _OpenLot:
    """A lot without a verdict: `sampled` cells wait for their simulation, `members` for the verdict. References in `awaited` are being
    simulated in the same batch."""

    lot: StoredLot
    errors: int = 0
    sampled: set[int] = field(default_factory=set)
    members: dict[int, StoredEvaluation] = field(default_factory=dict)
    awaited: set[int] = field(default_factory=set)

    @property
    def plan(self) -> SamplingPlan:
        return SamplingPlan(self.lot.size, self.lot.sample, self.lot.acceptance)


class Inspection:
    """The open lots of one campaign."""

    def __init__(self, campaign: int, evaluator: str, scale: Scale) -> None:
        self._campaign, self._evaluator, self._scale = campaign, evaluator, scale
        self._open: dict[int, _OpenLot] = {}

    def load(self, connection: Connection, pending: Mapping[int, StoredEvaluation]) -> dict[int, StoredEvaluation]:
        """Loads the lots without a verdict from committed rows, draws missing samples, and returns the drawn cells by id."""
        self._open = {}
        stored = {lot.id: lot for lot in lots.of_campaign(connection, self._campaign) if lot.size and lot.verdict is None}
        if not stored:  # a lot may wait for references alone
            return {}
        errors = lots.errors_so_far(connection, self._campaign, list(stored))
        self._open = {number: _OpenLot(lot, errors.get(number, 0)) for number, lot in stored.items()}
        reused = [number for number, lot in stored.items() if lot.kind is Outcome.REUSED]
        for number, references in lots.references(connection, self._campaign, reused).items():
            self._open[number].awaited = references & pending.keys()
        for cell in pending.values():
            if cell.lot in self._open and cell.purpose in INSPECTED:
                self._open[cell.lot].sampled.add(cell.id)
            elif cell.lot in self._open:
                self._open[cell.lot].members[cell.id] = cell
        drawn: dict[int, StoredEvaluation] = {}
        for lot in self._open.values():
            if len(lot.members) == lot.lot.size:
                drawn |= self._draw(connection, lot)
        return drawn

    def _draw(self, connection: Connection, lot: _OpenLot) -> dict[int, StoredEvaluation]:
        cells = sorted(lot.members.values(), key=lambda cell: cell.individual)
        identities = [f"{cell.scenario}:{cell.iteration}:{cell.individual}".encode() for cell in cells]
        chosen = [cells[place] for place in draw(identities, lot.plan.sample, lots.sample_key(connection, self._campaign))]
        for cell in chosen:
            del lot.members[cell.id]
            lot.sampled.add(cell.id)
        purpose = Purpose.SAMPLE if lot.lot.kind is Outcome.PREDICTED else Purpose.AUDIT
        evaluations.simulate(connection, [cell.id for cell in chosen], purpose=purpose)
        return {cell.id: cell._replace(plan=Outcome.SIMULATED, purpose=purpose) for cell in chosen}

    def compare(self, cell: StoredEvaluation, score: float | None) -> bool | None:
        """Takes a sampled cell's simulated score, None without a result, and returns whether the prediction was right; None for other
        cells. Samples of references are compared by the verdict, for their references may still be simulated."""
        lot = self._open.get(cell.lot or 0)
        if lot is None or cell.purpose not in INSPECTED:
            return None
        lot.sampled.discard(cell.id)
        if lot.lot.kind is not Outcome.PREDICTED or cell.predicted_score is None:
            return None
        right = score is not None and abs(score - cell.predicted_score) <= lot.lot.tolerance + self._scale.grain
        lot.errors += not right
        return right

    def conclude(
        self, connection: Connection, pending: Collection[int]
    ) -> tuple[list[tuple[StoredEvaluation, AnsweredCell]], list[StoredEvaluation]]:
        """Stores the verdicts of lots with a complete sample. Returns the released cells with their answers, and the cells to simulate.

        Stores answers of predicted cells, not of reused cells. All answers so far must be stored; `pending` cells have none. A verdict
        waits for the references of all cells and for the whole sample, even if it is certain before: it must not depend on the workers'
        timing. If the sample holds a member's very set as another individual, the member is simulated: this score is known, and its
        reference's may be refuted.
        """
        for lot in self._open.values():
            lot.awaited.intersection_update(pending)
        complete = [lot for lot in self._open.values() if not lot.sampled and not lot.awaited]
        self._compare_references(connection, complete)
        released: list[tuple[StoredEvaluation, AnsweredCell]] = []
        simulated: list[StoredEvaluation] = []
        for lot in complete:
            del self._open[lot.lot.id]
            cells = list(lot.members.values())
            releasable = self._not_drawn(connection, lot) if lot.plan.releases(lot.errors) else []
            answers = self._answers(connection, lot.lot.kind, releasable) if releasable else {}
            released += [(cell, answers[cell.id]) for cell in cells if cell.id in answers]
            simulated += [cell for cell in cells if cell.id not in answers]
        verdicts = {
            lot.lot.id: (LotVerdict.RELEASED if lot.plan.releases(lot.errors) else LotVerdict.REJECTED, lot.errors)
            for lot in complete
        }
        lots.conclude(connection, verdicts)
        predicted = {cell.lot for cell, answer in released if answer.outcome is Outcome.PREDICTED}
        lots.release_predictions(connection, self._campaign, sorted(number for number in predicted if number is not None))
        return released, simulated

    def _compare_references(self, connection: Connection, complete: Iterable[_OpenLot]) -> None:
        reused = {lot.lot.id: lot for lot in complete if lot.lot.kind is Outcome.REUSED}
        if not reused:
            return
        wrong = audits.wrong_in_lots(connection, self._campaign, self._evaluator, self._scale, list(reused))
        for number, lot in reused.items():
            lot.errors = wrong.get(number, 0)

    def _not_drawn(self, connection: Connection, lot: _OpenLot) -> list[StoredEvaluation]:
        """Returns the members of a lot whose set is not in its sample; lots of predictions hold each set once."""
        members = list(lot.members.values())
        if lot.lot.kind is Outcome.PREDICTED or not members:
            return members
        drawn = audits.sampled_sets(connection, self._campaign, lot.lot.id)
        return [cell for cell in members if cell.parameter_set_id not in drawn]

    def _answers(self, connection: Connection, kind: Outcome, cells: Collection[StoredEvaluation]) -> dict[int, AnsweredCell]:
        """Returns the answers of released cells, by id. A reference without a result answers no cell."""
        if kind is Outcome.PREDICTED:
            return {cell.id: AnsweredCell(cell.id, kind, cell.predicted_score, cell.predicted_rating, None) for cell in cells}
        references = {cell.id: cell.reference for cell in cells if cell.reference is not None}
        donors = audits.trusted(connection, self._campaign, self._evaluator, list(set(references.values())))
        with_result = {cell: donors[reference] for cell, reference in references.items() if reference in donors}
        return {
            cell: AnsweredCell(cell, kind, donor.score, donor.rating, donor.run, donor.failure)
            for cell, donor in with_result.items()
        }


def enters_lot(cell: RequestedCell, limit: float) -> bool:
    """Returns whether a planned cell's reference answers it after an inspection only. A `limit` of 1 makes no lots."""
    return cell.plan is Outcome.REUSED and not cell.from_equal_campaign and limit < 1.0


def form_lots_of_references(
    connection: Connection, view: View, cells: Sequence[RequestedCell], limit: float, rates: Mapping[str, ErrorRate]
) -> list[RequestedCell]:
    """Stores a lot for the reused cells of each scenario in a batch, and returns all cells, these with their lots.

    An answer is wrong if it is off by more than the scale's tolerance. `rates` are the audits so far; they choose how many errors a sample
    may hold. The sample of a very small lot is the whole lot.
    """
    members: dict[str, list[int]] = defaultdict(list)
    for place, cell in enumerate(cells):
        if enters_lot(cell, limit):
            members[cell.scenario].append(place)
    if not members:
        return list(cells)
    first, new = cells[0], []
    for scenario, places in members.items():
        plan = best_plan(len(places), limit, expected_error_rate(rates.get(scenario)))
        at = first.iteration, first.individual, scenario
        size = plan.size, plan.sample, plan.acceptance
        new.append(NewLot(*at, *size, view.bench.scale.tolerance, limit, known=0, seconds=0.0, kind=Outcome.REUSED))
    planned = list(cells)
    for places, number in zip(members.values(), lots.insert(connection, view.campaign, new), strict=True):
        for place in places:
            planned[place] = replace(planned[place], lot=number)
    return planned


def check_reuse(
    connection: Connection, view: View, iteration: int, scenarios: Sequence[str], before: Mapping[str, ErrorRate]
) -> dict[str, ErrorRate]:
    """Evaluates the audits of this and all earlier iterations of the calibration, and results that contradict each other. Without an
    influence map, nothing was reused."""
    if view.influence_map is None:
        return error_rates((), scenarios)
    campaign, bench = view.campaign, view.bench
    rater, scale = bench.evaluator_id, bench.scale
    audits.settle(connection, campaign, StageName.CALIBRATION, iteration, rater, scale)
    contradictions = audits.contradictions(connection, campaign, view.influence_map_sequence, rater, view.watermark, scale)
    concluded = [lot for lot in lots.of_campaign(connection, campaign, Outcome.REUSED) if lot.verdict is not None]
    inspected: dict[str, Counter[str]] = defaultdict(Counter)
    for lot in concluded:
        is_rejected = lot.verdict is LotVerdict.REJECTED
        inspected[lot.scenario].update(lots=1, inspected=lot.size, sampled=lot.sample, rejected=is_rejected)
    counts, bounds = audits.count(connection, campaign, rater, scale), _most_wrong(connection, campaign, concluded)
    rates = error_rates(counts, scenarios, contradictions, inspected, bounds)
    for scenario, rate in rates.items():
        if rate.rejected and not (scenario in before and before[scenario].rejected):
            data = {"scenario": scenario, "wrong": rate.wrong, "audited": rate.audited}
            events.add(connection, campaign, EventKind.LOT_REJECTED, data)
    return rates


def _most_wrong(connection: Connection, campaign: int, concluded: Iterable[StoredLot]) -> dict[str, float]:
    """Returns an upper 95 % limit of the share of wrong answers among the released ones of lots of references, by scenario."""
    plans: dict[str, list[tuple[SamplingPlan, int]]] = defaultdict(list)
    for lot in concluded:
        plans[lot.scenario].append((SamplingPlan(lot.size, lot.sample, lot.acceptance), lot.errors or 0))
    released = lots.released_cells(connection, campaign, Outcome.REUSED) if plans else {}
    return {name: min(1.0, most_released(plans[name]) / count) for name, count in released.items()}


def notes_on_lots(rates: Mapping[str, ErrorRate]) -> list[str]:
    """Returns notes on scenarios with rejected lots of references, and on lots so small that their samples are most of them."""
    rejected = [f"{name} ({rate.rejected} of {rate.lots})" for name, rate in rates.items() if rate.rejected]
    why = "lots of reused answers had too many wrong samples, so every cell of them was simulated"
    sampled, inspected = (sum(getattr(rate, name) for rate in rates.values()) for name in ("sampled", "inspected"))
    small = f"{sampled:,} of {inspected:,} cells that the map could answer were samples: a larger population or `max_error` saves more"
    return ([f"{why}: {', '.join(rejected)}"] if rejected else []) + ([small] if 2 * sampled > inspected else [])

"""Tracks one campaign's cells that wait for answers, and stores the results.

The database rows are authoritative: a tracker is loaded from them after every assignment and after a crash.
"""

import logging
import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import Connection

from drivecal.campaigns.cells.inspection import Inspection
from drivecal.campaigns.cells.planning import View, ensure_setups
from drivecal.campaigns.cells.score_faults import ScoreFaults
from drivecal.campaigns.resolve.bench import Bench
from drivecal.contracts.assignments import value_text
from drivecal.contracts.work import Cell, CellResult, Probe, SetupRequest
from drivecal.domain.errors import RefutedError
from drivecal.domain.evaluations import Donor, Outcome, Rating
from drivecal.domain.scales import plain
from drivecal.execution.measures import MEASURES
from drivecal.execution.scheduling.dispatches import Completed
from drivecal.execution.scheduling.in_flight import Work
from drivecal.reduction.audit import is_checked
from drivecal.storage import evaluations, leases, results, traces
from drivecal.storage.evaluations import COPIES, DONORS, AnsweredCell, NewEvaluation
from drivecal.storage.references import runs
from drivecal.storage.references.runs import NewRun, StoredRun
from drivecal.storage.references.withdrawal import withdraw_certified
from drivecal.storage.results import StoredEvaluation

LONGEST_DETAIL = 2_000
"""Characters kept of a cell's failure message."""

MOST_NAMED = 12
"""Parameters whose values are named in a note."""

log = logging.getLogger(__name__)


class CellTracker:
    """The cells of one campaign. Methods that change rows work inside the caller's transaction, and update the counts with them. After a
    failed transaction, discard the tracker and load another."""

    def __init__(self, view: View, counts: Mapping[str, int], simulating_seconds: float) -> None:
        """`counts` are the stage's cells so far, as in `contracts.campaign`."""
        self._view = view
        self._counts = Counter(counts)
        self._pending: dict[int, StoredEvaluation] = {}
        self._copies: dict[int, list[StoredEvaluation]] = {}
        self._breakdowns: Mapping[int, int] = {}
        self._proofs: dict[int, int] = {}
        """Evaluations whose runs reused cells without an answer would repeat: the answers of `_probes`."""
        self._requests: Mapping[int, SetupRequest] = {}
        self._inspection = Inspection(view.campaign, view.bench.evaluator_id, view.bench.scale)
        self._refuted: str | None = None
        self._refuted_setups: set[int] = set()
        self._exclusive = False
        self._evaluator_id = view.bench.evaluator_id
        self._from_series = view.bench.needs_series
        self.simulating_seconds = simulating_seconds
        self.faults = ScoreFaults(view.bench, self._counts)
        self.broken: str | None = None
        """Scenario, cause, number and parameter set of the first cell without a result; None before."""

    @property
    def counts(self) -> dict[str, int]:
        """The stage's cells by outcome."""
        return dict(self._counts)

    @property
    def waiting(self) -> int:
        """Cells without an answer."""
        return len(self._pending)

    def request(self, connection: Connection, cells: Sequence[NewEvaluation], carried_over: int) -> None:
        """Stores a planned population. Copies of stored results are answered at once."""
        evaluations.insert(connection, self._view.campaign, cells)
        self._counts["proposed"] += len(cells) + carried_over
        self._counts["carried_over"] += carried_over
        for cell in cells:
            if cell.answered_at_once:
                self._count(cell.plan)
            else:
                self._counts["pending"] += 1
        stored = [(cell.scenario, cell.donor) for cell in cells if cell.answered_at_once and cell.donor is not None]
        self.faults.note_stored(connection, stored)

    def load(self, connection: Connection, *, share_runs: bool, benches: Sequence[Bench] = ()) -> list[Work]:
        """Loads the cells that wait for an answer, draws the samples of new lots, and returns the work to simulate.

        The transaction must not be the one that stores new predictions: these are committed before their sample is drawn.

        With `share_runs`, a cell takes a run that another campaign simulated in the meantime, or certified if the cell may be. It counts as
        simulated or certified, because the campaign did not see that run when it planned. Without it, every cell is simulated for this
        campaign alone. `benches` lists the cells' benches besides the campaign's own.
        """
        self._requests = {
            setup_id: bench.requests[scenario]
            for bench in (self._view.bench, *benches)
            for scenario, setup_id in ensure_setups(connection, bench).items()
        }
        self._exclusive = not share_runs
        self._pending = {cell.id: cell for cell in results.pending(connection, self._view.campaign)}
        self._pending |= self._inspection.load(connection, self._pending)
        self._copies = {}
        reused = (cell for cell in self._pending.values() if cell.plan is Outcome.REUSED)
        self._proofs = {cell.id: cell.proven_by for cell in reused if cell.proven_by is not None}
        for cell in self._pending.values():
            if cell.plan in COPIES and cell.reference is not None and cell.lot is None:
                self._copies.setdefault(cell.reference, []).append(cell)
        answers: list[AnsweredCell] = []
        if share_runs:
            self._share_runs(connection, answers, self._pending.values())
        while rejected := self._settle(connection, answers):
            evaluations.simulate_instead(connection, [cell.id for cell in rejected])
            answers = []
            if share_runs:
                self._share_runs(connection, answers, self._pending.values())
        self._breakdowns = leases.breakdowns(connection, list(self._pending))
        simulated = [cell for cell in self._pending.values() if cell.plan is Outcome.SIMULATED]
        return self._work(simulated, self._probes(connection, simulated))

    def record(self, connection: Connection, completed: Sequence[Completed]) -> list[Work]:
        """Stores the results of simulated cells and of their copies; returns the work to simulate instead.

        Results without the current lease are late and change nothing: the cell was leased again.
        """
        answers: list[AnsweredCell] = []
        orphans: list[StoredEvaluation] = []
        again: list[StoredEvaluation] = []
        finished: list[tuple[StoredEvaluation, Completed, Rating]] = []
        late = self._late(connection, completed)
        for completion in completed:
            cell = self._pending.get(completion.result.id)
            if cell is None:  # answered already, by an earlier attempt
                continue
            if completion.result.id in late:
                again.append(cell)
            elif completion.result.breakdown is None:
                finished.append((cell, completion, self._rating(cell, completion.result)))
            else:
                orphans += self._break_down(cell, completion, answers)
        proofs = dict(pair for _, simulation, _ in finished for pair in simulation.result.probed)
        self._proofs |= proofs
        stored = runs.insert_results(connection, [self._new_run(*simulated) for simulated in finished])
        for (cell, simulation, rating), run in zip(finished, stored, strict=True):
            self._simulated(cell, simulation, rating, run, answers)
            if simulation.result.trace is not None:
                traces.fill(connection, self._view.campaign, simulation.result.trace)
        orphans += self._settle(connection, answers)
        evaluations.note_proofs(connection, proofs)
        evaluations.simulate_instead(connection, [orphan.id for orphan in orphans])
        if orphans and not self._exclusive:  # the sample of a lot may hold the very cell
            known: list[AnsweredCell] = []
            self._share_runs(connection, known, orphans)
            evaluations.answer(connection, known)
            orphans = [orphan for orphan in orphans if orphan.id in self._pending]
        if self._refuted_setups:
            withdrawn = withdraw_certified(connection, self._refuted_setups)
            log.error("%s; %d answers of its setup by certificates are withdrawn", self._refuted, withdrawn)
        return self._work([*again, *orphans])

    def _settle(self, connection: Connection, answers: list[AnsweredCell]) -> list[StoredEvaluation]:
        """Stores answers and the verdicts that follow from them; returns the cells that are to be simulated instead."""
        evaluations.answer(connection, answers)
        released, rejected = self._inspection.conclude(connection, self._pending.keys())
        for cell, answer in released:
            self._close(cell, answer.outcome)
        reused = [(cell, answer) for cell, answer in released if answer.outcome is not Outcome.PREDICTED]
        evaluations.answer(connection, [replace(answer, proven_by=self._proofs.get(cell.id)) for cell, answer in reused])
        for cell in rejected:
            self._pending[cell.id] = replace(cell, plan=Outcome.SIMULATED, reference=None)
        return [self._pending[cell.id] for cell in rejected]

    def _probes(self, connection: Connection, simulated: Sequence[StoredEvaluation]) -> dict[int, tuple[Probe, ...]]:
        """Distributes the reused cells of an iteration over simulated cells of the same setup, by cell id."""
        if self._view.checked_certificates is None or not simulated or not self._view.keys:
            return {}
        probes: dict[int, list[Probe]] = {}
        place = simulated[0].stage, simulated[0].iteration
        reused = (cell for cell in self._pending.values() if cell.plan is Outcome.REUSED and cell.id not in self._proofs)
        waiting = [(cell.id, cell.setup_id, cell.parameters) for cell in reused]
        for number, setup_id, parameters in [*evaluations.reused(connection, self._view.campaign, *place), *waiting]:
            probes.setdefault(setup_id, []).append(Probe(number, parameters.floats))
        carriers: dict[int, list[int]] = {}
        for cell in simulated:
            carriers.setdefault(cell.setup_id, []).append(cell.id)
        return {
            carrier: tuple(probes[setup_id][position :: len(carrying)])
            for setup_id, carrying in carriers.items()
            if setup_id in probes
            for position, carrier in enumerate(carrying)
        }

    def _late(self, connection: Connection, completed: Sequence[Completed]) -> set[int]:
        """Cells whose results come from a lease that is over. A result obtained for another cell has no lease of its own."""
        numbers = {
            completion.result.id: completion.lease
            for completion in completed
            if completion.lease is not None and not completion.shared
        }
        late = numbers.keys() - leases.current(connection, numbers)
        if late:
            MEASURES.count("late_results", times=len(late))
            log.warning(
                "%d results came too late and change nothing: their leases were over, e.g. of cell %d", len(late), min(late)
            )
        return late

    def _work(self, cells: Sequence[StoredEvaluation], probes: Mapping[int, tuple[Probe, ...]] | None = None) -> list[Work]:
        by_setup: dict[int, list[Cell]] = {}
        for pending in sorted(cells, key=lambda cell: not (cell.sampled or cell.audited)):  # lots wait for their samples
            cell = self._cell(pending)
            if probes and pending.id in probes:
                cell = replace(cell, probes=probes[pending.id])
            by_setup.setdefault(pending.setup_id, []).append(cell)
        return [
            Work(
                self._requests[setup_id],
                tuple(listed),
                self._exclusive,
                {cell.id: self._breakdowns[cell.id] for cell in listed if cell.id in self._breakdowns},
            )
            for setup_id, listed in by_setup.items()
        ]

    def _cell(self, pending: StoredEvaluation) -> Cell:
        """Returns the cell to simulate. An audited cell is always simulated, and checks a certificate on the way."""
        share, repeated = self._view.checked_certificates, self._view.bench.repeated_share
        if share is None:
            twice = repeated is not None and is_checked(pending.scenario, pending.parameters, repeated, self._view.campaign)
            return Cell(pending.id, pending.parameters.floats, check=twice, trace=self._view.traced)
        check = pending.audited or is_checked(pending.scenario, pending.parameters, share, self._view.campaign)
        return Cell(pending.id, pending.parameters.floats, certify=True, check=check)

    def raise_if_refuted(self) -> None:
        """Raises RefutedError if a simulation contradicts its certificate, which is a bug. Call it after the results are committed."""
        if self._refuted is not None:
            raise RefutedError(self._refuted)

    def _share_runs(self, connection: Connection, answers: list[AnsweredCell], cells: Iterable[StoredEvaluation]) -> None:
        """Answers cells of which a run is stored by now."""
        wanted: dict[int, list[StoredEvaluation]] = {}
        for waiting in cells:
            if waiting.plan is Outcome.SIMULATED:
                wanted.setdefault(waiting.setup_id, []).append(waiting)
        for setup_id in sorted(runs.stocked(connection, wanted)):
            here = wanted[setup_id]
            ids = [cell.parameter_set_id for cell in here]
            stored = runs.look_up_exact(connection, setup_id, ids, self._evaluator_id, watermark=sys.maxsize)
            proofs = runs.proofs(connection, [donor.run for donor in stored.values()])
            known = [(cell, stored[cell.parameter_set_id]) for cell in here if cell.parameter_set_id in stored]
            taken = [(cell, run) for cell, run in known if run.run not in proofs or self._cell(cell).may_be_certified]
            self.faults.note_stored(connection, [(cell.scenario, run) for cell, run in taken])
            for cell, run in taken:
                self._answer(cell, run, answers, proof=proofs.get(run.run))

    def _rating(self, cell: StoredEvaluation, result: CellResult) -> Rating:
        """Returns a result's rating, which workers do not know for bundles. A failed run cannot beat it (`Scale.worth`)."""
        bench, score, rating = self._view.bench, result.score, result.rating
        if bench.rates and (rated := bench.rate(cell.scenario, result.metrics, result.failure)) is not None:
            score, rating = rated.score, rated.rating
            self.faults.note(cell.scenario, rated)
        if score is None or rating is None:
            raise ValueError(f"evaluation {cell.id} has no score, or lacks a measure that its score needs")
        score, rating = (bench.scale.worth(value, failed=result.failure is not None) for value in (score, rating))
        return Rating(float(rating), plain(score))

    def _simulated(
        self, cell: StoredEvaluation, completion: Completed, rating: Rating, run: StoredRun, answers: list[AnsweredCell]
    ) -> None:
        self._counts["unrepeatable"] += not run.agrees or completion.result.repeats is False
        if completion.result.agrees is False:
            self._refuted = _refutation(cell, completion)
            self._refuted_setups.add(cell.setup_id)
        donor = Donor(cell.id, run.id, rating.score, rating.rating, completion.result.failure)
        if completion.shared:  # counted where it was simulated
            proof = completion.result.proven_by if completion.result.is_certified else None
            self._answer(cell, donor, answers, proof=proof)
        else:
            self.simulating_seconds += completion.result.milliseconds / 1000
            self._answer(cell, donor, answers, completion)

    def _answer(
        self,
        cell: StoredEvaluation,
        result: Donor,
        answers: list[AnsweredCell],
        simulation: Completed | None = None,
        proof: int | None = None,
    ) -> None:
        """Answers a cell with its own result, and the copies that waited for it. `proof`: the evaluation that another campaign's result
        repeats by a certificate."""
        for other in (cell, *self._copies.pop(cell.id, ())):
            own = simulation if other is cell else None
            certified, proven_by = other is cell and proof is not None, self._proofs.get(other.id)
            if own is not None:
                certified, proven_by = own.result.is_certified, own.result.proven_by
            outcome = Outcome.CERTIFIED if certified else other.plan
            self._counts["checked"] += own is not None and own.result.agrees is not None
            answers.append(
                AnsweredCell(
                    *(other.id, outcome, result.score, result.rating, result.run, result.failure),
                    **_attempt(own),
                    agrees=self._inspection.compare(other, result.score),
                    proven_by=proof if own is None and certified else proven_by,
                    proof_agrees=None if own is None else own.result.agrees,
                )
            )
            self._close(other, outcome)

    def _break_down(self, cell: StoredEvaluation, completion: Completed, answers: list[AnsweredCell]) -> list[StoredEvaluation]:
        """Fails a cell without a result after all attempts. Copies of the same parameter set fail with it; other copies become orphans."""
        orphans: list[StoredEvaluation] = []
        detail = None if completion.result.detail is None else _storable(completion.result.detail)
        if self.broken is None:
            self.broken = f"{cell.scenario}: {completion.result.breakdown}: {detail or 'no message'} ({_place(cell)})"
        for other in (cell, *self._copies.pop(cell.id, ())):
            if other.plan is Outcome.REUSED:
                orphans.append(other)
                continue
            own = completion if other is cell and not completion.shared else None
            answers.append(
                AnsweredCell(
                    *(other.id, Outcome.FAILED, None, None, None, completion.result.breakdown),
                    **_attempt(own),
                    agrees=self._inspection.compare(other, None),
                    detail=detail,
                )
            )
            self._close(other, Outcome.FAILED)
        for position, other in enumerate(orphans):
            orphans[position] = self._pending[other.id] = replace(other, plan=Outcome.SIMULATED, reference=None)
        return orphans

    def _close(self, cell: StoredEvaluation, outcome: Outcome) -> None:
        del self._pending[cell.id]
        self._counts["pending"] -= 1
        self._count(outcome)
        if outcome is Outcome.SIMULATED and cell.audited:
            self._counts["audited"] += 1
        if outcome in DONORS and cell.sampled:
            self._counts["sampled"] += 1

    def _count(self, outcome: Outcome) -> None:
        self._counts["requested"] += 1
        self._counts[outcome.value] += 1

    def _new_run(self, cell: StoredEvaluation, completion: Completed, rating: Rating) -> NewRun:
        return NewRun(
            setup_id=cell.setup_id,
            parameter_set_id=cell.parameter_set_id,
            metrics=completion.result.metrics,
            failure=completion.result.failure,
            milliseconds=completion.result.run_milliseconds,
            wall_milliseconds=completion.result.wall_milliseconds,
            worker=completion.worker,
            evaluator=self._evaluator_id,
            score=rating.score,
            rating=rating.rating,
            evaluation_id=cell.id,
            campaign_sequence=self._view.campaign,
            stage=cell.stage,
            iteration=cell.iteration,
            individual=cell.individual,
            from_series=self._from_series,
        )


def _attempt(own: Completed | None) -> dict[str, Any]:
    """Returns the fields of the cell's own attempts; empty for a copy."""
    return {} if own is None else {"milliseconds": own.result.milliseconds, "worker": own.worker, "attempts": own.attempts}


def _refutation(cell: StoredEvaluation, completion: Completed) -> str:
    where = f"evaluation {cell.id} in {cell.scenario}"
    if completion.result.proven_by is None:
        return f"{where} is not deterministic on {completion.worker}: equal decisions led to different states. Its certificates are invalid"
    return (
        f"{where} was to repeat evaluation {completion.result.proven_by} bit for bit, but its simulation on {completion.worker}"
        " differs: the driving function's certificates are wrong. Set reduction.certified: false, and report this bug"
    )


def _place(cell: StoredEvaluation) -> str:
    """Returns a cell's number and parameter set, as `drivecal evaluate` takes it."""
    shown = [f"{name}={value_text(value)}" for name, value in cell.parameters.floats.items()]
    more = f" and {len(shown) - MOST_NAMED} more" if len(shown) > MOST_NAMED else ""
    return f"evaluation {cell.id}, {' '.join(shown[:MOST_NAMED])}{more}"


def _storable(words: str) -> str:
    """Makes a worker's message storable in every database."""
    return words[:LONGEST_DETAIL].encode(errors="replace").decode().replace("\0", "\ufffd")

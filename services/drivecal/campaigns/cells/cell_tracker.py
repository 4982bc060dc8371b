"""Tracks one campaign's cells that wait for answers, and stores the results.

The database rows are authoritative: a tracker is loaded from them after every assignment and after a crash.
"""

import logging
import sys
from collections import Counter
from collections.abc import Iterable, Mapping, MutableMapping, Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import Connection

from drivecal.analysis.scoring import cut_text, rate
from drivecal.bundles.expressions import Formula
from drivecal.campaigns.cells.inspection import Inspection
from drivecal.campaigns.cells.planning import View, ensure_setups
from drivecal.campaigns.resolve.bench import Bench
from drivecal.contracts.assignments import value_text
from drivecal.contracts.work import Cell, CellResult, SetupRequest
from drivecal.domain.evaluations import ANSWERED_BY_DONOR, INSPECTED, Breakdown, Donor, Outcome, Rating, RequestedCell
from drivecal.domain.scales import plain
from drivecal.execution.measures import MEASURES
from drivecal.execution.scheduling.in_flight import Completed, RunBudget, Work
from drivecal.reduction.assignment import is_checked
from drivecal.storage import evaluations, leases, results, traces
from drivecal.storage.evaluations import AnsweredCell
from drivecal.storage.references import runs
from drivecal.storage.references.runs import NewRun, StoredRun
from drivecal.storage.results import StoredEvaluation


class ScoreFaults:
    """Counts runs without a value of a score as `unscored`, and with a score that was cut off as `cut`, among the `counts` of a stage: by
    the campaign's score, and by the others among its objectives and constraints."""

    def __init__(self, view: View, counts: MutableMapping[str, int]) -> None:
        self._bench, self._counts = view.bench, counts
        self._others = [(each.scale, Formula(each.formula)) for each in view.scores if each.scale and each.formula]
        self.undefined: str | None = None
        """Reason why the first such score has no value; None before."""
        self.cut: str | None = None
        """Scenario and true value of the first score that was cut off; None before."""

    def note(self, scenario: str, rated: Rating | None, measures: Mapping[str, float | None], failure: str | None) -> None:
        """Takes a run with its rating by the campaign's score, None if that has no fault."""
        known = {name: value for name, value in measures.items() if value is not None}
        others = [(scale, rate(formula, scale, known, failure)) for scale, formula in self._others]
        ratings = [(scale, each) for scale, each in ((self._bench.scale, rated), *others) if each is not None]
        undefined = next((each.undefined for _, each in ratings if each.undefined is not None), None)
        self._counts["unscored"] += undefined is not None
        self.undefined = self.undefined or undefined
        cut = [cut_text(scenario, scale.name, each.cut, scale.failed) for scale, each in ratings if each.cut is not None]
        self._counts["cut"] += bool(cut)
        self.cut = self.cut or next(iter(cut), None)

    def note_stored(self, connection: Connection, stored: Sequence[tuple[str, Donor]]) -> None:
        """Takes answers of stored runs, by scenario. Only formulas know which have faults: runs that may have some are rated again."""
        worst = None if self._bench.evaluator is not None else self._bench.scale.failed
        doubtful = [each for each in stored if each[1].failure is None and (self._others or each[1].score == worst)]
        measures = runs.values_of(connection, {donor.run for _, donor in doubtful})
        for scenario, donor in doubtful:
            rated = self._bench.rate(scenario, measures[donor.run][0], None) if donor.score == worst else None
            self.note(scenario, rated, measures[donor.run][0], None)


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
        self._returned: set[int] = set()
        """Cells whose work was returned: they are at workers, or wait for one."""
        self._twice: set[int] = set()
        """Cells for which the budget gave a second run."""
        self._copies: dict[int, list[StoredEvaluation]] = {}
        self._breakdowns: Mapping[int, int] = {}
        self._requests: Mapping[int, SetupRequest] = {}
        self._inspection = Inspection(view.campaign, view.bench.evaluator_id, view.bench.scale)
        self._exclusive = False
        self._evaluator_id = view.bench.evaluator_id
        self._from_series = view.bench.needs_series
        self.simulating_seconds = simulating_seconds
        self.budget = RunBudget()
        """Changes with every request and answer."""
        self._counts_starts = False
        """True until the budget includes the cells without an answer."""
        self.faults = ScoreFaults(view, self._counts)
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

    def waits_for(self, iteration: int) -> bool:
        """Returns whether a cell of an iteration has no answer."""
        return any(cell.iteration == iteration for cell in self._pending.values())

    def note_discarded(self, cells: int) -> None:
        """Sets the number of cells that the search has given up."""
        self._counts["discarded"] = cells

    def request(self, connection: Connection, cells: Sequence[RequestedCell], carried_over: int) -> None:
        """Stores a planned population. Copies of stored results are answered at once."""
        evaluations.insert(connection, self._view.campaign, cells)
        self.budget.kept = max(0.0, self.budget.kept - len(cells))
        if not self._counts_starts:
            self.budget.left -= sum(not cell.answered_at_once for cell in cells)
        self._counts["proposed"] += len(cells) + carried_over
        self._counts["carried_over"] += carried_over
        for cell in cells:
            if cell.answered_at_once:
                self._count(cell.plan)
            else:
                self._counts["pending"] += 1
        stored = [(cell.scenario, cell.donor) for cell in cells if cell.answered_at_once and cell.donor is not None]
        self.faults.note_stored(connection, stored)

    def limit(self, runs: int) -> None:
        """Limits the starts of the simulator in this stage, those so far included, before its cells are loaded."""
        spent = self._counts["runs"] - self._counts["lost"] + (self._counts["shared"] if self._view.isolated else 0)
        self.budget, self._counts_starts = RunBudget(runs - spent), True

    def limit_cells(self, cells: int) -> None:
        """Limits the cells that a search by the cell may ask for, those so far included."""
        self.budget.kept = max(0, cells - self._counts["requested"] - self._counts["pending"])

    def load(self, connection: Connection, *, share_runs: bool, benches: Sequence[Bench] = ()) -> list[Work]:
        """Loads the cells that wait for an answer, and draws the samples of new lots. Returns the work to simulate, without cells that it
        returned before.

        Predictions must be committed before their sample is drawn, so store new predictions in an earlier transaction.

        With `share_runs`, a cell takes a run that another campaign simulated in the meantime. It counts as simulated, because the campaign
        did not see that run when it planned. Without it, every cell is simulated for this campaign alone. `benches` lists the cells'
        benches besides the campaign's own.
        """
        requests = dict(self._requests)
        for bench in (self._view.bench, *benches):
            requests |= {number: bench.requests[name] for name, number in ensure_setups(connection, bench).items()}
        self._exclusive = not share_runs
        earlier = self._returned & self._pending.keys()
        self._pending = {cell.id: cell for cell in results.pending(connection, self._view.campaign)}
        self._pending |= self._inspection.load(connection, self._pending)
        waiting = {cell.setup_id for cell in self._pending.values()}
        self._requests = {number: request for number, request in requests.items() if number in waiting}
        self._copies = {}
        for cell in self._pending.values():
            if cell.plan in ANSWERED_BY_DONOR and cell.reference is not None and cell.lot is None:
                self._copies.setdefault(cell.reference, []).append(cell)
        self.budget.taken = dict.fromkeys(self._pending, 0) | self.budget.taken
        if self._counts_starts:  # before cells are answered, which gives their starts back
            self.budget.taken.update(leases.starts(connection, list(self._pending)))
            self.budget.left -= len(self._pending) + sum(self.budget.taken.values())
            self._counts_starts = False
        while rejected := self._settle(connection, self._share_runs(connection, self._pending.values())):
            self._simulate(connection, rejected)
        self._breakdowns = leases.breakdowns(connection, list(self._pending))
        wanted = [cell for cell in self._pending.values() if cell.plan is Outcome.SIMULATED and cell.id not in earlier]
        self._returned = earlier | {cell.id for cell in wanted}
        return self._work(wanted)

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
            elif (rating := self._rating(cell, completion.result)) is not None:
                finished.append((cell, completion, rating))
            else:
                failed, copies = self._break_down(cell, completion)
                answers += failed
                orphans += copies
        stored = runs.insert_results(connection, [self._new_run(*simulated) for simulated in finished])
        pairs = zip(finished, stored, strict=True)
        others = {cell.id: each.result.metrics for (cell, each, _), run in pairs if not (run.agrees and run.is_whole)}
        evaluations.store(connection, "metrics", others)
        for (cell, simulation, rating), run in zip(finished, stored, strict=True):
            answers += self._simulated(cell, simulation, rating, run)
            if simulation.result.trace is not None:
                traces.fill(connection, self._view.campaign, simulation.result.trace)
        orphans = self._simulate(connection, [*orphans, *self._settle(connection, answers)])
        if orphans:  # the sample of a lot may hold the very cell
            self._store(connection, self._share_runs(connection, orphans))
        return self._work([*again, *(orphan for orphan in orphans if orphan.id in self._pending)])

    def _settle(self, connection: Connection, answers: list[AnsweredCell]) -> list[StoredEvaluation]:
        """Stores answers and the verdicts that follow from them; returns the cells that are to be simulated instead."""
        self._store(connection, answers)
        released, rejected = self._inspection.conclude(connection, self._pending.keys())
        for cell, answer in released:
            self._close(cell, answer.outcome)
        reused = [answer for _, answer in released if answer.outcome is not Outcome.PREDICTED]
        self._store(connection, reused)
        return rejected

    def _simulate(self, connection: Connection, cells: Sequence[StoredEvaluation]) -> list[StoredEvaluation]:
        """Has cells simulated that other results were to answer; returns them as they are planned now."""
        evaluations.simulate(connection, [cell.id for cell in cells], reference=None)
        planned = [cell._replace(plan=Outcome.SIMULATED, reference=None) for cell in cells]
        self._pending |= {cell.id: cell for cell in planned}
        return planned

    def _store(self, connection: Connection, answers: Sequence[AnsweredCell]) -> None:
        """Stores answers, and counts the starts of the simulator for their cells."""
        started, lost, shared = evaluations.answer(connection, answers)
        self._counts["runs"] += started
        self._counts["lost"] += lost
        self._counts["shared"] += shared
        self.budget.left -= started - lost + (shared if self._view.isolated else 0)

    def _late(self, connection: Connection, completed: Sequence[Completed]) -> set[int]:
        """Cells whose results come from a lease that is over. A result obtained for another cell has no lease of its own."""
        numbers = {each.result.id: each.lease for each in completed if each.lease is not None}
        late = numbers.keys() - leases.current(connection, numbers)
        if late:
            MEASURES.late_results.inc(len(late))
            log.warning("%d results came after their leases and change nothing, e.g. of cell %d", len(late), min(late))
        return late

    def _work(self, cells: Sequence[StoredEvaluation]) -> list[Work]:
        by_setup: dict[int, list[Cell]] = {}
        for pending in sorted(cells, key=lambda cell: cell.purpose not in INSPECTED):  # lots wait for their samples
            by_setup.setdefault(pending.setup_id, []).append(self._cell(pending))
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
        share = 0.0 if pending.id in self._breakdowns else self._view.bench.repeated_share  # a suspect runs once
        seed = self._requests[pending.setup_id].seed
        twice = is_checked(pending.scenario, seed, pending.parameters, share, self._view.seed)
        twice = twice and (pending.id in self._twice or self.budget.take(pending.id, beyond=self.budget.kept))
        if twice:
            self._twice.add(pending.id)
        return Cell(pending.id, pending.parameters.floats, check=twice, trace=self._view.traced)

    def _share_runs(self, connection: Connection, cells: Iterable[StoredEvaluation]) -> list[AnsweredCell]:
        """Answers cells whose runs are stored by now, unless every cell is simulated for this campaign alone."""
        answers: list[AnsweredCell] = []
        wanted: dict[int, list[StoredEvaluation]] = {}
        for waiting in cells:
            if waiting.plan is Outcome.SIMULATED and not self._exclusive:
                wanted.setdefault(waiting.setup_id, []).append(waiting)
        for setup_id in sorted(runs.stocked(connection, wanted)):
            here = wanted[setup_id]
            ids = [cell.parameter_set_id for cell in here]
            stored = runs.look_up_exact(connection, setup_id, ids, self._evaluator_id, watermark=sys.maxsize)
            taken = [(cell, stored[cell.parameter_set_id]) for cell in here if cell.parameter_set_id in stored]
            self.faults.note_stored(connection, [(cell.scenario, run) for cell, run in taken])
            for cell, run in taken:
                answers += self._answer(cell, run)
        return answers

    def _rating(self, cell: StoredEvaluation, result: CellResult) -> Rating | None:
        """Returns a result's rating; None without a run, and if the run cannot be rated."""
        rated = None if result.breakdown is not None else self._view.bench.rate_result(cell.scenario, result)
        if rated is None:
            return None
        self.faults.note(cell.scenario, rated, result.metrics, result.failure)
        return Rating(float(rated.rating), plain(rated.score))

    def _simulated(self, cell: StoredEvaluation, completion: Completed, rating: Rating, run: StoredRun) -> list[AnsweredCell]:
        self._counts["unrepeatable"] += not run.agrees or completion.result.repeats is False
        own = None if completion.shared else completion  # what is shared was counted where it was simulated
        self.simulating_seconds += 0.0 if own is None else own.result.milliseconds / 1000
        return self._answer(cell, Donor(cell.id, run.id, rating.score, rating.rating, completion.result.failure), own)

    def _answer(self, cell: StoredEvaluation, result: Donor, own: Completed | None = None) -> list[AnsweredCell]:
        """Answers a cell with its own result, and the copies that waited for it."""
        answer = AnsweredCell(cell.id, cell.plan, result.score, result.rating, result.run, result.failure)
        return self._answered((cell, *self._copies.pop(cell.id, ())), own, answer)

    def _break_down(self, cell: StoredEvaluation, completion: Completed) -> tuple[list[AnsweredCell], list[StoredEvaluation]]:
        """Fails a cell without a result after all attempts, and the copies of its parameter set. Returns the other copies as well."""
        cause, detail = completion.result.breakdown, completion.result.detail
        if cause is None:
            cause, detail = Breakdown.ERROR.value, "the run has no score, or lacks a measure that its score needs"
        if self.broken is None:
            self.broken = f"{cell.scenario}: {cause}: {detail or 'no message'} ({_place(cell)})"
        copies = self._copies.pop(cell.id, [])
        failed = [cell, *(copy for copy in copies if copy.plan is not Outcome.REUSED)]
        own = None if completion.shared else completion
        answer = AnsweredCell(cell.id, Outcome.FAILED, None, None, None, cause, detail=_storable(detail))
        return self._answered(failed, own, answer), [copy for copy in copies if copy.plan is Outcome.REUSED]

    def _answered(self, cells: Sequence[StoredEvaluation], own: Completed | None, answer: AnsweredCell) -> list[AnsweredCell]:
        """Gives the first cell's answer to all: the others are its copies. `own`: its attempts, None if it was not sent itself."""
        answers = []
        for cell in cells:
            attempt = own if cell is cells[0] else None
            outcome = Outcome.FAILED if answer.outcome is Outcome.FAILED else cell.plan
            agrees = self._inspection.compare(cell, answer.score)
            detail = answer.detail or (None if attempt is None else _storable(attempt.result.detail))
            answers.append(replace(answer, id=cell.id, outcome=outcome, agrees=agrees, detail=detail, **_attempt(attempt)))
            self._close(cell, outcome)
        return answers

    def _close(self, cell: StoredEvaluation, outcome: Outcome) -> None:
        self.budget.give_back(cell.id)
        del self._pending[cell.id]
        self._counts["pending"] -= 1
        self._count(outcome)
        if outcome is Outcome.SIMULATED and cell.purpose in INSPECTED:
            self._counts[INSPECTED[cell.purpose]] += 1

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
    names = ("worker", "attempts", "unstarted")
    return {} if own is None else {name: getattr(own, name) for name in names} | {"milliseconds": own.result.milliseconds}


def _storable(detail: str | None) -> str | None:
    """Returns a message as every database can store it."""
    return detail and detail[:LONGEST_DETAIL].encode(errors="replace").decode().replace("\0", "\ufffd")


def _place(cell: StoredEvaluation) -> str:
    """Returns a cell's number and parameter set, as `drivecal evaluate` takes it."""
    shown = [f"{name}={value_text(value)}" for name, value in cell.parameters.floats.items()]
    more = f" and {len(shown) - MOST_NAMED} more" if len(shown) > MOST_NAMED else ""
    return f"evaluation {cell.id}, {' '.join(shown[:MOST_NAMED])}{more}"

"""The loop of every stage: requests cells round by round, plans and stores them, and passes their answers on in that order."""

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, Literal

from sqlalchemy import Connection

from drivecal.analysis.scoring import REMEDY
from drivecal.campaigns.cells.cell_tracker import CellTracker
from drivecal.campaigns.cells.planning import View, plan_cells
from drivecal.campaigns.cells.rerating import rate_stored_runs
from drivecal.campaigns.resolve.bench import Bench
from drivecal.campaigns.resolve.problem import CalibrationProblem, EvaluationProblem
from drivecal.campaigns.results.failures import broken_down
from drivecal.contracts.campaign import CellCounts, Progress
from drivecal.contracts.specification import ReductionSpecification
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import InvalidInputError, NoResultError, NotFoundError, Problem
from drivecal.domain.evaluations import CellScore, Outcome, RequestedCell
from drivecal.domain.events import EventKind
from drivecal.execution.scheduling.in_flight import Completed, RunBudget, Work
from drivecal.storage import campaigns, evaluations, events, results, studies
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database

SECONDS_TO_JUDGE = 5.0
"""The pace is unknown while workers start."""
SHARE_TO_JUDGE = 0.01
ANSWERS_TO_JUDGE = 10
MOST_MOMENTS = 500


class EtaEstimate:
    """Estimates a stage's remaining time by the pace of the newer half of the workers' answers since this process resumed the
    stage. Answers without a simulation come at once: they count as answered together with the worker's answer before them."""

    def __init__(self, clock: Callable[[], float], done: int, worked: int) -> None:
        """Begins with `done` cells, `worked` of them by workers; `clock` returns seconds."""
        self._clock = clock
        self._seen = [(clock(), done, worked)]
        """Moments with the counts then; every second one is dropped if there are many."""

    def progress(self, done: int, total: int, worked: int) -> Progress:
        """`done` of `total` cells, with the remaining time once there is enough data."""
        now = self._clock()
        if worked > self._seen[-1][2]:
            self._seen.append((now, done, worked))
        else:
            self._seen[-1] = (self._seen[-1][0], done, self._seen[-1][2])
        if len(self._seen) > MOST_MOMENTS:
            self._seen = self._seen[::2]
        begin, done_before, worked_before = self._seen[0]
        answers = worked - worked_before
        known = now - begin >= SECONDS_TO_JUDGE and done - done_before >= SHARE_TO_JUDGE * (total - done_before)
        needed = max(ANSWERS_TO_JUDGE, answers / 2)
        since = next((each for each in reversed(self._seen) if worked - each[2] >= needed), None) if known else None
        seconds = None if since is None else (now - since[0]) / max(1, done - since[1]) * max(0, total - done)
        return Progress(done=done, total=total, eta_seconds=seconds)


def worked(cells: Mapping[str, int]) -> int:
    """Returns how many of a stage's cells workers have answered, with or without a result."""
    return sum(cells.get(outcome, 0) for outcome in (Outcome.SIMULATED, Outcome.FAILED))


ALL_FAILED = 30
"""First simulations of a stage, by iteration, individual and scenario, that end it if all have failed and no other cell has a result. Where
nine of ten cells break down, at most one stage in 23 ends so, however fast failures and however slow results are."""


@dataclass(frozen=True, slots=True)
class Round:
    """Cells that a stage requests together, with their bench and the permitted kinds of answer."""

    number: int
    cells: Sequence[tuple[Bench, Sequence[RequestedCell]]]
    policy: ReductionSpecification
    carried_over: int = 0
    before: int | None = None
    """Own answers from this iteration on are not seen, so that rounds under way do not depend on the order of answers; None to see all."""


Wait = Literal["answers", "computation", "sets", "nothing"]
"""A stage that has returned its work waits for answers of its cells, for a computation (or its next look for sets), for sets that another
program proposes, or for nothing, because it is complete."""


class Stage(ABC):
    """A stage of a campaign: `work` returns cells to simulate, `record` takes their results, until it waits for nothing. It ends early
    if nothing in it has a result.

    The database holds all state after every call, so a new object continues exactly as this object would. By default it requests the
    finished rounds again and receives their stored answers.
    """

    name: ClassVar[StageName]
    uses_map: ClassVar[bool] = False
    """True if its view needs the campaign's influence map."""

    ends_early: ClassVar[bool] = True
    """True if it fails when its first cells return no result."""

    asks_ahead: ClassVar[bool] = False
    """True if `work` may return more cells while earlier cells are at workers."""

    write_seconds: float = 0.25
    """Least interval between transactions with results while cells are at workers: half of the time of small ones is fixed."""

    budget: RunBudget | None = None
    """Runs that the stage may start; None without a limit."""

    def __init__(
        self, database: Database, campaign: StoredCampaign, problem: CalibrationProblem | EvaluationProblem, view: View
    ) -> None:
        counts = campaign.counts(self.name)
        self._problem = problem
        self._database = database
        self._campaign = campaign
        self._view = view
        self._tracker = CellTracker(view, counts.model_dump(), campaign.simulating_seconds)
        self._eta = EtaEstimate(time.monotonic, counts.requested, worked(counts.model_dump()))
        self._rated = {view.bench.fingerprints}
        """Setups whose stored runs the campaign's evaluator has rated."""
        self._resumed = False
        self._round: Round | None = None
        """The newest round."""
        self._under_way: deque[Round] = deque()
        """Rounds that the stage has no answers of, in the order of asking."""
        self._recorded = {count for count in ("unscored", "cut", "failed") if getattr(counts, count)}

    @abstractmethod
    def _ask(self) -> Round | None:
        """Returns the next round; None when the stage is complete."""

    @abstractmethod
    def _tell(self, asked: Round) -> None:
        """Takes the answers of a completely answered round."""

    @property
    @abstractmethod
    def _at_most(self) -> int:
        """The largest number of cells that the stage may request, as far as known."""

    def _resume(self) -> list[Work]:
        """Resumes from stored rows if the stage does not request its finished rounds again."""
        return []

    def _awaited(self) -> Wait | None:  # a hook
        """Returns what has to happen before the stage can resume or ask for its next round without long computations in the dispatcher's
        loop; None if nothing has."""
        return None

    def _may_ask(self) -> bool:  # a hook
        """Returns whether the next round may be asked for: by default if the one before is answered."""
        return not self._under_way

    def _store(self, connection: Connection, asked: Round) -> None:  # noqa: B027  # a hook
        """Stores the data and events of a new round besides its cells."""

    def _conclude(self) -> None:  # noqa: B027  # a hook
        """Stores the outcome of the stage."""

    def _snapshot(self, connection: Connection) -> StoredCampaign:
        """The campaign with the progress to store; subclasses extend it."""
        self._record_firsts(connection)
        counts = CellCounts(**self._tracker.counts)
        return replace(
            self._campaign,
            stage=self.name,
            iteration=None if self._round is None else self._round.number,
            progress=self._progress(counts.requested, counts.proposed),
            simulating_seconds=self._tracker.simulating_seconds,
        )

    def _record_firsts(self, connection: Connection) -> None:
        """Adds an event for the stage's first score without a value, its first score that was cut off, and its first cell without a result:
        others may take as long to fail, e.g. if a simulator hangs."""
        firsts = {
            "unscored": ("a score has no value, so that its run counts as failed", self._tracker.faults.undefined),
            "cut": ("a score is cut off", self._tracker.faults.cut),
            "failed": ("a cell has no result after all attempts", self._tracker.broken),
        }
        for count, (what, first) in firsts.items():
            if first is not None and count not in self._recorded:
                events.add(connection, self._campaign.sequence, EventKind.NOTE, {"text": f"{what}: {first}"})
                self._recorded.add(count)

    def _score_notes(self) -> list[str]:
        """Returns notes on scores without a value and on scores that were cut off."""
        endings = {
            "unscored": (
                "has no value and counts as a failed run",
                "have no value and count as failed runs",
                "see the causes of failures",
            ),
            "cut": (
                "is worse than the worth of a failed run and counts as it",
                "are worse than the worth of a failed run and count as it",
                REMEDY,
            ),
        }
        counts = self._tracker.counts
        return [
            f"1 score of the {self.name} {single}: {advice}"
            if counts[name] == 1
            else f"{counts[name]:,} scores of the {self.name} {several}: {advice}"
            for name, (single, several, advice) in endings.items()
            if counts.get(name)
        ]

    def _progress(self, requested: int, proposed: int) -> Progress:
        return self._eta.progress(requested, max(self._at_most, proposed), worked(self._tracker.counts))

    def work(self) -> tuple[list[Work], Wait]:
        """Returns what to simulate next, and what the stage waits for then. It is not called again after it waits for nothing.

        It may be called while earlier cells are at workers (`asks_ahead`).

        Raises NoResultError if everything so far has failed, also in an earlier process.
        """
        self._refuse_failures()
        work: list[Work] = []
        if not self._resumed:
            if (awaited := self._awaited()) is not None:
                return work, awaited
            work += self._resume()
            self._resumed = True
        while True:
            while self._under_way and not self._tracker.waits_for(self._under_way[0].number):
                self._tell(self._under_way.popleft())
            if not self._may_ask() or (self._tracker.waiting and not self._under_way):
                return work, "answers"
            if (awaited := self._awaited()) is not None:
                return work, awaited
            asked = self._ask()
            if asked is None:
                if self._under_way:
                    return work, "answers"
                self._conclude()
                return work, "nothing"
            self._round = asked
            self._under_way.append(asked)
            work += self._request(asked)

    def record(self, completed: Sequence[Completed]) -> list[Work]:
        """Stores results, in one transaction with the counters that they change; returns what to simulate in their place.

        Raises NoResultError if everything so far has failed.
        """
        with self._database.transaction() as connection:
            work = self._tracker.record(connection, completed)
            self._save(connection)
        self._refuse_failures()
        return work

    def _request(self, asked: Round) -> list[Work]:
        """Commits the cells of a round before any is dispatched; resumes them unchanged if an earlier process committed them."""
        sequence, has_lots = self._campaign.sequence, False
        benches = [bench for bench, _ in asked.cells if bench is not self._view.bench]
        for bench in benches:
            if bench.fingerprints not in self._rated:
                rate_stored_runs(self._database, replace(self._view, bench=bench))
                self._rated.add(bench.fingerprints)
        load = partial(self._tracker.load, share_runs=asked.policy.mode != "off", benches=benches)
        first = asked.cells[0][1][0].individual if asked.cells and asked.cells[0][1] else None
        with self._database.transaction() as connection:
            is_new = not results.is_requested(connection, sequence, self.name, asked.number, first)
            if not is_new and not results.is_pending(connection, sequence, self.name, asked.number):
                return []  # over before this process began; cells that wait belong to a later round
            if is_new:
                for position, (bench, cells) in enumerate(asked.cells):
                    view = self._view if bench is self._view.bench else replace(self._view, bench=bench)
                    planned = plan_cells(connection, view, asked.policy, self.name, asked.number, cells, asked.before)
                    with view.reuse_time.counted():
                        planned = self._form_lots(connection, asked, self._affordable(connection, asked, planned))
                    self._tracker.request(connection, planned, carried_over=0 if position else asked.carried_over)
                    has_lots |= any(cell.lot is not None for cell in planned)
                self._store(connection, asked)
            work = [] if has_lots else load(connection)
            self._save(connection)
        if has_lots:
            with self._database.transaction() as connection:  # a sample is drawn after its lot is committed
                work = load(connection)
                self._save(connection)
        return work

    def _affordable(self, connection: Connection, asked: Round, planned: list[RequestedCell]) -> list[RequestedCell]:  # a hook
        """Returns the first cells under a seed of a round: those for which the budget suffices. Called once for each seed."""
        del connection, asked
        return planned

    def _form_lots(self, connection: Connection, asked: Round, planned: list[RequestedCell]) -> list[RequestedCell]:  # a hook
        """Puts reused cells into lots, and replaces simulations by predictions in lots. All these cells are stored."""
        del connection, asked
        return planned

    def _save(self, connection: Connection) -> None:
        campaigns.save_progress(connection, self._snapshot(connection), {self.name: CellCounts(**self._tracker.counts)})

    def _refuse_failures(self) -> None:
        counts = CellCounts(**self._tracker.counts)
        if not self.ends_early or counts.failed < ALL_FAILED or counts.failed != counts.requested:
            return
        first = self._database.query(evaluations.first_simulated, self._campaign.sequence, self.name, ALL_FAILED)
        if len(first) == ALL_FAILED and all(outcome is Outcome.FAILED for outcome in first):
            raise NoResultError(f"all {counts.failed:,} tried cells of the {self.name} gave no result{self._causes()}")

    def _causes(self) -> str:
        """Returns the most frequent causes of failed cells, for an error message."""
        causes = self._database.query(broken_down, self._campaign.sequence)
        listed = "; ".join(f"{cause.cells:,} x {cause.cause}: {cause.detail or 'no message'}" for cause in causes[:3])
        return f": {listed}" if listed else ""


def exact_policy(problem: CalibrationProblem) -> ReductionSpecification:
    """Returns the policy of stages that reuse nothing: answers by equal sets, or by no stored result if the campaign wants none."""
    return ReductionSpecification(mode="off" if problem.specification.reduction.mode == "off" else "exact")


def ended_source(connection: Connection, campaign_id: str, field: str) -> StoredCampaign:
    """Returns the campaign that a study names. Raises InvalidInputError if there is none, or if it has not ended."""
    try:
        source = campaigns.get(connection, campaign_id)
    except NotFoundError as error:
        raise InvalidInputError(Problem(field, str(error), "`drivecal list` prints what there is")) from error
    if source.kind != "calibration" or not source.state.ended:
        kind = "campaign" if source.kind == "calibration" else "single evaluation"
        message = f"{campaign_id} is a {kind} that is {source.state}"
        raise InvalidInputError(Problem(field, message, "name a campaign that has ended"))
    return source


class StudyStage(Stage):
    """A study of a campaign. Its cells are answered by equal parameter sets or simulated, never reused."""

    _problem: CalibrationProblem
    _valued: results.Valued | None = None
    """Computes the values of a run that its answers need besides the score."""

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

    def _store(self, connection: Connection, asked: Round) -> None:
        if asked.number == 0:
            begun = {"stage": self.name, "cells": self._at_most}
            events.add(connection, self._campaign.sequence, EventKind.STAGE, begun)
        studies.save(connection, self._campaign.sequence, self.name, self._outcome())

    def _conclude(self) -> None:
        with self._database.transaction() as connection:
            studies.save(connection, self._campaign.sequence, self.name, {**self._outcome(), "complete": True})
            self._save(connection)

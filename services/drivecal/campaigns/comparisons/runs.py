"""Runs a comparison: each run is an ordinary campaign, a few at a time.

A run sees no results of other campaigns, so neither their order nor earlier results change its results or counts. Cells that several runs
request, or that were simulated before, are still not simulated again (`cell_tracker`, `execution.scheduling.scheduler`): this saves work,
but does not show in the counts.
"""

import logging
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Self

from drivecal.analysis.confirmation import remarkable
from drivecal.campaigns.comparisons.resolve import ComparisonProblem
from drivecal.campaigns.job import Job
from drivecal.campaigns.stages.eta import EtaEstimate, worked
from drivecal.contracts.campaign import Baseline, Best, ErrorRate
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.errors import DrivecalError, NoResultError, RefutedError, SupersededError, UnavailableError
from drivecal.domain.events import EventKind
from drivecal.execution.scheduling.dispatches import Completed
from drivecal.execution.scheduling.in_flight import Work
from drivecal.reduction.audit import clopper_pearson
from drivecal.storage import campaign_stages, campaigns, comparisons, events
from drivecal.storage.campaigns import Snapshot, StoredCampaign
from drivecal.storage.comparisons import RunTally
from drivecal.storage.engine.database import Database

SECONDS_BETWEEN_SUMS = 1.0
"""Largest delay of a comparison's own row behind its runs."""
MOST_NOTES = 20
TOLD = 5
"""Failed runs listed in the comparison's error."""

log = logging.getLogger(__name__)


class ComparisonJob(Job):
    """A comparison as a job. The rows of its runs hold all state; the comparison's own row is their sum."""

    def __init__(
        self, database: Database, campaign: StoredCampaign, problem: ComparisonProblem, take_up: Callable[[int], Job]
    ) -> None:
        """`take_up` returns the job of a campaign by its number."""
        self._database = database
        self._sequence = campaign.sequence
        self._at_a_time = problem.specification.at_a_time
        self._expected = problem.at_most
        self._sign = problem.problems[0].bench.scale.sign
        self._take_up = take_up
        self._jobs: dict[int, Job] = {}
        """The jobs of the running runs, by number."""
        self._begun = False
        self._first: list[Work] = []
        """Work of the runs that have begun, until all have that are to run at first."""
        self._homes: dict[int, int] = {}
        """The run of each cell at the workers."""
        self._unwanted: set[int] = set()
        """Cells of ended runs that were not answered."""
        with database.read() as connection:
            self._waiting = comparisons.open_runs(connection, campaign.sequence)
            total = _Sum.over(comparisons.tallies(connection, campaign.sequence), self._sign)
        self._next_sum = time.monotonic()
        self._eta = EtaEstimate(time.monotonic, total.done, total.worked)
        self.finished = False

    def work(self) -> list[Work]:
        """Returns what to simulate next. Raises NoResultError at the end if runs failed; results of the others are kept."""
        work, self._first = self._first + self._go_on(), []
        # After a lost transaction cells are at workers still: the dispatcher has to know of all of them at once.
        self._begun = self._begun or not any(job.goes_on for job in self._jobs.values())
        if not self._begun:
            self._first, self.goes_on = work, True
            return []
        over = not self._jobs and not self._waiting
        self.goes_on = not work and not self._homes and not over
        self._sum_up_when_due(over=over)
        if over:
            self._refuse_failures()
            self.finished = True
        return work

    def record(self, completed: Sequence[Completed]) -> list[Work]:
        """Stores results, run by run; returns what to simulate instead or next."""
        by_run: dict[int, list[Completed]] = {}
        for completion in completed:
            home = self._homes.pop(completion.result.id, None)
            if home is not None:
                by_run.setdefault(home, []).append(completion)
        work: list[Work] = []
        for number, mine in by_run.items():
            if number in self._jobs:  # else it failed meanwhile
                work += self._guarded(number, partial(_record, mine))
        work += self._go_on()
        self._sum_up_when_due()
        return work

    def take_unwanted(self) -> Collection[int]:
        """Returns the unanswered cells of runs that failed, and forgets them."""
        unwanted, self._unwanted = self._unwanted, set()
        return unwanted

    def _go_on(self) -> list[Work]:
        """Starts runs if there is room, and advances runs that wait for nothing. Returns after one run finishes, so that an answered
        comparison leaves the dispatcher time for other campaigns."""
        while self._waiting and len(self._jobs) < self._at_a_time:
            self._begin(self._waiting.pop(0))
        work: list[Work] = []
        for number in list(self._jobs):
            work += self._guarded(number, lambda job: job.work())
            if number in self._jobs and self._jobs[number].finished:
                self._end(number, CampaignState.SUCCEEDED)
                break
        return work

    def _begin(self, number: int) -> None:
        with self._database.transaction() as connection:
            campaigns.start(connection, number)  # or it is running already
        self._guarded(number, None)

    def _guarded(self, number: int, act: Callable[[Job], list[Work]] | None) -> list[Work]:
        """Confines an error to its own run; but a refuted certificate casts doubt on all runs."""
        try:
            if act is None:
                self._jobs[number] = self._take_up(number)
                return []
            work = act(self._jobs[number])
        except (UnavailableError, SupersededError, RefutedError):
            raise
        except DrivecalError as error:
            self._end(number, CampaignState.FAILED, str(error))
            return []
        except Exception as error:  # a bug, of an optimizer for example
            log.exception("a run of the comparison failed")
            self._end(number, CampaignState.FAILED, f"internal error: {type(error).__name__}: {error}")
            return []
        self._homes.update((cell.id, number) for batch in work for cell in batch.cells)
        return work

    def _end(self, number: int, state: CampaignState, error: str | None = None) -> None:
        self._jobs.pop(number, None)
        self._unwanted |= {cell for cell, home in self._homes.items() if home == number}
        self._homes = {cell: home for cell, home in self._homes.items() if home != number}
        with self._database.transaction() as connection:
            campaigns.end(connection, number, state, error)
            run = campaigns.by_sequence(connection, number)
            ended, of = comparisons.ended_of(connection, self._sequence)
            data = {
                "run": run.id,
                "name": run.name,
                "state": state,
                "best": None if run.best is None else run.best.objective,
                "ended": ended,
                "of": of,
            }
            events.add(connection, self._sequence, EventKind.RUN, data)

    def _refuse_failures(self) -> None:
        with self._database.read() as connection:
            _, of = comparisons.ended_of(connection, self._sequence)
            failed, first = comparisons.failed_runs(connection, self._sequence, TOLD)
        if failed:
            listed = "; ".join(f"{name}: {error}" for name, error in first)
            more = f"; and {failed - TOLD} more" if failed > TOLD else ""
            raise NoResultError(f"{failed} of {of} runs failed: {listed}{more}")

    def _sum_up_when_due(self, *, over: bool = False) -> None:
        if over or time.monotonic() >= self._next_sum:
            self.sum_up()

    def sum_up(self) -> None:
        """Stores the sums over the runs in the comparison's own row."""
        self._next_sum = time.monotonic() + SECONDS_BETWEEN_SUMS
        with self._database.transaction() as connection:
            total = _Sum.over(comparisons.tallies(connection, self._sequence), self._sign)
            snapshot = Snapshot(
                stage=StageName.CALIBRATION,
                iteration=None,
                cells={stage: campaign_stages.counts(total.stages, stage) for stage in total.stages},
                progress=self._eta.progress(total.done, max(self._expected, total.done), total.worked),
                error_rate={scenario: _rate(audits) for scenario, audits in total.audits.items() if audits["audited"]},
                best=total.best,
                baseline=total.baseline,
                simulating_seconds=total.simulating_seconds,
                notes=total.told(),
            )
            campaigns.save_progress(connection, self._sequence, snapshot)


@dataclass(slots=True)
class _Sum:
    """Totals over the runs, in constant memory."""

    sign: int = 1
    stages: dict[StageName, Counter[str]] = field(default_factory=dict)
    audits: dict[str, Counter[str]] = field(default_factory=dict)
    """Sums over all runs by scenario. Shared cells count for each run."""
    best: Best | None = None
    """The best set of all runs, of equal ones the first run's."""
    baseline: Baseline | None = None
    simulating_seconds: float = 0.0
    notes: dict[str, list[str]] = field(default_factory=dict)
    begun: int = 0

    @classmethod
    def over(cls, runs: Iterable[RunTally], sign: int) -> Self:
        """Sums up runs; `sign`: -1 if lower objectives are better."""
        total = cls(sign=sign)
        for run in runs:
            total._add(run)
        return total

    @property
    def done(self) -> int:
        return sum(cells["requested"] for cells in self.stages.values())

    @property
    def worked(self) -> int:
        return sum(worked(cells) for cells in self.stages.values())

    def _add(self, run: RunTally) -> None:
        for stage, cells in run.stages.items():
            self.stages.setdefault(stage, Counter()).update(cells)
        for scenario, rate in run.error_rate.items():
            self.audits.setdefault(scenario, Counter()).update(rate.model_dump(exclude={"upper_95"}))
        if run.best is not None and (self.best is None or self.sign * (run.best.objective - self.best.objective) > 0):
            self.best = run.best
        self.baseline = self.baseline or run.baseline
        self.simulating_seconds += run.simulating_seconds
        self.begun += run.begun
        for note in remarkable(run.notes):  # the tables show the optima
            self.notes.setdefault(note, []).append(run.name)

    def told(self) -> list[str]:
        """The notes of the runs: once if all runs share a note, else with run names, and only the first of very many."""
        lines = [
            line
            for note, names in self.notes.items()
            for line in ([note] if len(names) == self.begun else [f"{name}: {note}" for name in names])
        ]
        return lines[:MOST_NOTES]


def _rate(audits: Mapping[str, int]) -> ErrorRate:
    counts = {name: audits[name] for name in ("audited", "different", "wrong", "contradictions", "lots", "rejected")}
    upper = None if audits["lots"] else clopper_pearson(audits["wrong"], audits["audited"])[1]  # lots have a bound in each run
    return ErrorRate(**counts, upper_95=upper, stopped=bool(audits["stopped"]))


def _record(completed: Sequence[Completed], job: Job) -> list[Work]:
    return job.record(completed)

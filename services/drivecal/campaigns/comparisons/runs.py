"""Carries a comparison out: its runs, each an ordinary campaign, a few at a time.

What a run finds and counts is its own affair: it sees the results of no other campaign, so neither their order nor what was stored
before changes anything of it. Cells that several runs ask for, or that were simulated before, are not simulated again all the same
(`cell_tracker`, `execution.scheduling.scheduler`): the workers gain by that, the counts do not show it.
"""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Self

from drivecal.analysis.confirmation import remarkable
from drivecal.campaigns.cells.cell_tracker import Work
from drivecal.campaigns.comparisons.resolve import ComparisonProblem
from drivecal.campaigns.job import Job
from drivecal.campaigns.stages.eta import EtaEstimate
from drivecal.contracts.campaign import Baseline, Best, ErrorRate
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.errors import DrivecalError, NoResultError, RefutedError, SupersededError, UnavailableError
from drivecal.domain.events import EventKind
from drivecal.execution.scheduling.scheduler import Completed
from drivecal.reduction.audit import clopper_pearson
from drivecal.storage import campaign_stages, campaigns, comparisons, events
from drivecal.storage.campaigns import Snapshot, StoredCampaign
from drivecal.storage.comparisons import RunTally
from drivecal.storage.engine.database import Database

SECONDS_BETWEEN_SUMS = 1.0
"""A comparison's own row is that much behind its runs at most."""
MOST_NOTES = 20
TOLD = 5
"""Of the runs that failed, in the comparison's error."""

log = logging.getLogger(__name__)


class ComparisonJob(Job):
    """A comparison as a job. All state is in the rows of its runs; that of its own row is the sum of theirs."""

    def __init__(
        self,
        database: Database,
        campaign: StoredCampaign,
        problem: ComparisonProblem,
        take_up: Callable[[int], Job],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`take_up` gives the job of a campaign by its number."""
        self._database = database
        self._sequence = campaign.sequence
        self._at_a_time = problem.specification.at_a_time
        self._expected = problem.at_most
        self._take_up = take_up
        self._jobs: dict[int, Job] = {}
        """Of the runs in work, by number."""
        self._homes: dict[int, int] = {}
        """The run of each cell at the workers."""
        with database.read() as connection:
            self._waiting = comparisons.open_runs(connection, campaign.sequence)
            done = _Sum.over(comparisons.tallies(connection, campaign.sequence)).done
        self._clock, self._next_sum = clock, clock()
        self._eta = EtaEstimate(clock, done)
        """Whether there is more to do now, though nothing was given to simulate and nothing is awaited."""
        self.finished = False

    def work(self) -> list[Work]:
        """What to simulate next. Raises NoResultError at the end where runs failed; what the others found is there all the same."""
        work = self._go_on()
        over = not self._jobs and not self._waiting
        self.goes_on = not work and not self._homes and not over
        self._sum_up_when_due(over=over)
        if over:
            self._refuse_failures()
            self.finished = True
        return work

    def record(self, completed: Sequence[Completed]) -> list[Work]:
        """Writes results down, run by run; gives what is to be simulated instead, or next."""
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

    def _go_on(self) -> list[Work]:
        """Starts runs where there is room, and moves on those that wait for nothing. One that ends ends the turn, so that a comparison
        whose answers are all there leaves the dispatcher time for others."""
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
        """Takes a run up, or does something with it. What is wrong with one run fails that one and no other; but a refuted proof casts
        doubt on all."""
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
        self._homes = {cell: home for cell, home in self._homes.items() if home != number}
        with self._database.transaction() as connection:
            campaigns.end(connection, number, state, error)
            run = campaigns.by_sequence(connection, number)
            ended, of = comparisons.ended_of(connection, self._sequence)
            told = {
                "run": run.id,
                "name": run.name,
                "state": state,
                "best": None if run.best is None else run.best.objective,
                "ended": ended,
                "of": of,
            }
            events.add(connection, self._sequence, EventKind.RUN, told)

    def _refuse_failures(self) -> None:
        with self._database.read() as connection:
            _, of = comparisons.ended_of(connection, self._sequence)
            failed, first = comparisons.failed_runs(connection, self._sequence, TOLD)
        if failed:
            listed = "; ".join(f"{name}: {error}" for name, error in first)
            more = f"; and {failed - TOLD} more" if failed > TOLD else ""
            raise NoResultError(f"{failed} of {of} runs failed: {listed}{more}")

    def _sum_up_when_due(self, *, over: bool = False) -> None:
        if over or self._clock() >= self._next_sum:
            self.sum_up()

    def sum_up(self) -> None:
        """Sums up in the comparison's own row what its runs count."""
        self._next_sum = self._clock() + SECONDS_BETWEEN_SUMS
        with self._database.transaction() as connection:
            found = _Sum.over(comparisons.tallies(connection, self._sequence))
            snapshot = Snapshot(
                stage=StageName.CALIBRATION,
                iteration=None,
                cells={stage: campaign_stages.counts(found.stages, stage) for stage in found.stages},
                progress=self._eta.progress(found.done, max(self._expected, found.done)),
                error_rate={scenario: _rate(audits) for scenario, audits in found.audits.items() if audits["audited"]},
                best=found.best,
                baseline=found.baseline,
                simulating_seconds=found.simulating_seconds,
                notes=found.told(),
            )
            campaigns.save_progress(connection, self._sequence, snapshot)


@dataclass(slots=True)
class _Sum:
    """Of what the runs count, one after the other: their number bounds nothing that is kept."""

    stages: dict[StageName, Counter[str]] = field(default_factory=dict)
    audits: dict[str, Counter[str]] = field(default_factory=dict)
    """Of all runs together, by scenario. What runs have in common counts for each of them."""
    best: Best | None = None
    """The best set of all runs, of equal ones the first run's."""
    baseline: Baseline | None = None
    simulating_seconds: float = 0.0
    notes: dict[str, list[str]] = field(default_factory=dict)
    begun: int = 0

    @classmethod
    def over(cls, runs: Iterable[RunTally]) -> Self:
        found = cls()
        for run in runs:
            found._add(run)
        return found

    @property
    def done(self) -> int:
        return sum(cells["requested"] for cells in self.stages.values())

    def _add(self, one: RunTally) -> None:
        for stage, cells in one.stages.items():
            self.stages.setdefault(stage, Counter()).update(cells)
        for scenario, rate in one.error_rate.items():
            self.audits.setdefault(scenario, Counter()).update(rate.model_dump(exclude={"upper_95"}))
        if one.best is not None and (self.best is None or one.best.objective > self.best.objective):
            self.best = one.best
        self.baseline = self.baseline or one.baseline
        self.simulating_seconds += one.simulating_seconds
        self.begun += one.begun
        for note in remarkable(one.notes):  # optima are told by the tables
            self.notes.setdefault(note, []).append(one.name)

    def told(self) -> list[str]:
        """What the runs note: once where all do, else with the run's name, of very many the first."""
        lines = [
            line
            for note, names in self.notes.items()
            for line in ([note] if len(names) == self.begun else [f"{name}: {note}" for name in names])
        ]
        return lines[:MOST_NOTES]


def _rate(audits: Mapping[str, int]) -> ErrorRate:
    counts = {name: audits[name] for name in ("audited", "different", "wrong", "contradictions")}
    upper = clopper_pearson(audits["wrong"], audits["audited"])[1]
    return ErrorRate(**counts, upper_95=upper, stopped=bool(audits["stopped"]))


def _record(completed: Sequence[Completed], job: Job) -> list[Work]:
    return job.record(completed)

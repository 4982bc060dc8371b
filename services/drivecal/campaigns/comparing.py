"""Carries a comparison out: its runs, each an ordinary campaign, a few at a time.

What a run finds and counts is its own affair: it sees the results of no other campaign, so neither their order nor what was stored
before changes anything of it. Cells that several runs ask for, or that were simulated before, are not simulated again all the same
(`ledger`, `execution.scheduler`): the workers gain by that, the counts do not show it.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from functools import partial

from drivecal.campaigns.comparison import ComparisonProblem
from drivecal.campaigns.ledger import Work
from drivecal.campaigns.pace import Pace
from drivecal.campaigns.selfcheck import clopper_pearson
from drivecal.campaigns.staged import StagedCampaign
from drivecal.contracts.campaign import Best, CellCounts, ErrorRate, StageCellCounts
from drivecal.domain.campaigns import CampaignState, Stage
from drivecal.domain.errors import DrivecalError, NoResultError, RefutedError, SupersededError, UnavailableError
from drivecal.domain.events import EventKind
from drivecal.execution.scheduler import Completed
from drivecal.storage import campaigns, events
from drivecal.storage.campaigns import Snapshot, StoredCampaign
from drivecal.storage.database import Database

SECONDS_BETWEEN_SUMS = 1.0
"""A comparison's own row is that much behind its runs at most."""
MOST_NOTES = 20
TOLD = 5
"""Of the runs that failed, in the comparison's error."""

log = logging.getLogger(__name__)


class Comparison:
    """Gives and takes work as `StagedCampaign` does. All state is in the rows of its runs; that of its own row is the sum of theirs."""

    def __init__(
        self,
        database: Database,
        campaign: StoredCampaign,
        problem: ComparisonProblem,
        take_up: Callable[[int], StagedCampaign],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`take_up` gives the job of a campaign by its number."""
        self._database = database
        self._sequence = campaign.sequence
        self._at_a_time = problem.specification.at_a_time
        self._expected = problem.at_most
        self._take_up = take_up
        self._jobs: dict[int, StagedCampaign] = {}
        """Of the runs in work, by number."""
        self._homes: dict[int, int] = {}
        """The run of each cell at the workers."""
        with database.read() as connection:
            runs = campaigns.runs_of(connection, campaign.sequence)
        self._waiting = [one for one in runs if not one.state.ended]
        self._clock, self._next_sum = clock, clock()
        self._pace = Pace(clock, _done(runs))
        self.stage = Stage.CALIBRATION
        self.goes_on = False
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
        for one in completed:
            home = self._homes.pop(one.result.id, None)
            if home is not None:
                by_run.setdefault(home, []).append(one)
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
            work += self._guarded(number, StagedCampaign.work)
            if number in self._jobs and self._jobs[number].finished:
                self._end(number, CampaignState.SUCCEEDED)
                break
        return work

    def _begin(self, run: StoredCampaign) -> None:
        with self._database.transaction() as connection:
            campaigns.start(connection, run.sequence)  # or it is running already
        self._guarded(run.sequence, None)

    def _guarded(self, number: int, act: Callable[[StagedCampaign], list[Work]] | None) -> list[Work]:
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
        self._homes.update((cell.id, number) for one in work for cell in one.cells)
        return work

    def _end(self, number: int, state: CampaignState, error: str | None = None) -> None:
        self._jobs.pop(number, None)
        self._homes = {cell: home for cell, home in self._homes.items() if home != number}
        with self._database.transaction() as connection:
            campaigns.end(connection, number, state, error)
            runs = campaigns.runs_of(connection, self._sequence)
            run = next(one for one in runs if one.sequence == number)
            told = {
                "run": run.id,
                "name": run.name,
                "state": state,
                "best": None if run.best is None else run.best.objective,
                "ended": sum(one.state.ended for one in runs),
                "of": len(runs),
            }
            events.add(connection, self._sequence, EventKind.RUN, told)

    def _refuse_failures(self) -> None:
        with self._database.read() as connection:
            runs = campaigns.runs_of(connection, self._sequence)
        failed = [one for one in runs if one.state is not CampaignState.SUCCEEDED]
        if failed:
            listed = "; ".join(f"{one.name}: {one.error}" for one in failed[:TOLD])
            more = f"; and {len(failed) - TOLD} more" if len(failed) > TOLD else ""
            raise NoResultError(f"{len(failed)} of {len(runs)} runs failed: {listed}{more}")

    def _sum_up_when_due(self, *, over: bool = False) -> None:
        if over or self._clock() >= self._next_sum:
            self.sum_up()

    def sum_up(self) -> None:
        """Sums up in the comparison's own row what its runs count."""
        self._next_sum = self._clock() + SECONDS_BETWEEN_SUMS
        with self._database.transaction() as connection:
            runs = campaigns.runs_of(connection, self._sequence)
            done = _done(runs)
            snapshot = Snapshot(
                stage=self.stage,
                iteration=None,
                cells=CellCounts(**_sums([one.cells for one in runs])),
                sensitivity_cells=StageCellCounts(**_sums([one.sensitivity_cells for one in runs])),
                progress=self._pace.progress(done, max(self._expected, done)),
                error_rate=_error_rates(runs),
                best=_best(runs),
                baseline=next((one.baseline for one in runs if one.baseline is not None), None),
                simulating_seconds=sum(one.simulating_seconds for one in runs),
                notes=_notes(runs),
            )
            campaigns.save_progress(connection, self._sequence, snapshot)


def _record(completed: Sequence[Completed], job: StagedCampaign) -> list[Work]:
    return job.record(completed)


def _done(runs: Sequence[StoredCampaign]) -> int:
    return sum(one.cells.requested + one.sensitivity_cells.requested for one in runs)


def _sums(counts: Sequence[CellCounts] | Sequence[StageCellCounts]) -> dict[str, int]:
    return {name: sum(getattr(one, name) for one in counts) for name in type(counts[0]).model_fields}


def _error_rates(runs: Sequence[StoredCampaign]) -> dict[str, ErrorRate]:
    """The audits of all runs together, by scenario; none where none was made. What runs have in common counts for each of them."""
    found: dict[str, list[ErrorRate]] = {}
    for one in runs:
        for scenario, rate in one.error_rate.items():
            found.setdefault(scenario, []).append(rate)
    return {scenario: _together(rates) for scenario, rates in found.items() if any(one.audited for one in rates)}


def _together(rates: Sequence[ErrorRate]) -> ErrorRate:
    audited, different, wrong = (sum(getattr(one, name) for one in rates) for name in ("audited", "different", "wrong"))
    stopped, contradictions = any(one.stopped for one in rates), sum(one.contradictions for one in rates)
    upper = clopper_pearson(wrong, audited)[1]
    return ErrorRate(
        audited=audited, different=different, wrong=wrong, upper_95=upper, stopped=stopped, contradictions=contradictions
    )


def _notes(runs: Sequence[StoredCampaign]) -> list[str]:
    """What the runs note: once where all do, else with the run's name, of very many the first."""
    by_note: dict[str, list[str]] = {}
    for one in runs:
        for note in one.notes:
            by_note.setdefault(note, []).append(one.name)
    begun = sum(one.started_at is not None for one in runs)
    told = [
        line
        for note, names in by_note.items()
        for line in ([note] if len(names) == begun else [f"{name}: {note}" for name in names])
    ]
    return told[:MOST_NOTES]


def _best(runs: Sequence[StoredCampaign]) -> Best | None:
    """The best set of all runs, of equal ones the first run's."""
    found = [one.best for one in runs if one.best is not None]
    return max(found, key=lambda best: best.objective) if found else None

"""The search of a campaign whose sets another program proposes: rounds are the sets that wait, as far as workers and budget suffice.

Sets that no round has asked for yet can be cancelled, so that rounds take only as many cells as keep the workers busy. Cells that the
reference table answers cost nothing and do not count.
"""

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from sqlalchemy import Connection

from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.stages.answers import CellAnswers
from drivecal.campaigns.stages.asking import WINDOW, AskedRound, Asker
from drivecal.campaigns.stages.calibration import Calibration
from drivecal.campaigns.stages.stage import Round, Stage
from drivecal.contracts.campaign import SearchEnd
from drivecal.domain.evaluations import Outcome, Purpose, RequestedCell
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.outside import sets as outside_sets
from drivecal.storage.outside.sets import OutsideSet

LOOK_SECONDS, LONGEST_LOOK = 0.05, 1.0
"""Interval (s) of checks for new sets, and of transactions with results: a tenth of the time without a set, between these."""
MOST_SETS = 1_000
"""Sets of a round."""


class OutsideSearch(Calibration):
    """The first round is the baseline, if there is one. The search ends by its budget, or when the campaign is asked to finish and every
    set is answered."""

    def __init__(self, database: Database, campaign: StoredCampaign, problem: CalibrationProblem, view: View) -> None:
        super().__init__(database, campaign, problem, view)
        if self._limit is not None:
            self._tracker.limit(self._limit, 0)  # answers of the table cost nothing
            self.budget = self._tracker.budget
        self._window = sys.maxsize  # no round waits for the answers of another one
        self._ahead = WINDOW * self._search.room
        """Cells that may wait for workers."""
        self._most = self._ahead
        """Sets that the next round tries to ask for: fewer after a cut, because each set is looked up again."""
        self._offered: Sequence[OutsideSet] = ()
        self._look_at, self._fed_at = 0.0, time.monotonic()

    def _begin(self) -> None:
        super()._begin()
        for number in range(self._closed):
            self._forget(number)

    def _forget(self, number: int) -> None:
        self._asked.pop(number)
        if isinstance(self._answers, CellAnswers):
            self._answers.forget(number)

    def _compute(self, obtain: Callable[[], Asker]) -> None:
        """Does nothing: no search computes."""

    def _may_ask(self) -> bool:
        return not self._under_way or (self._search.ended_by is None and self._tracker.waiting < self._ahead)

    def _is_ready(self) -> bool:
        """Returns whether a set waits or the search ends; otherwise it is to be asked again."""
        is_read = super()._is_ready()
        if not self._resumed or self._search.ended_by is not None or self._begins_with_baseline:
            return is_read
        if time.monotonic() < self._look_at:
            return False
        with self._database.read() as connection:
            closes, self._offered = outside_sets.waiting(connection, self._campaign.sequence, self._most)
        reason = self._end_before(max(1, self._next))
        if reason is None and closes and not self._offered:
            reason = "finished"
        if reason is not None:
            self._end_search(reason)
        elif self._offered:
            self._fed_at = time.monotonic()
        pause = min(LONGEST_LOOK, max(LOOK_SECONDS, (time.monotonic() - self._fed_at) / 10))
        self._look_at, self.write_seconds = time.monotonic() + pause, min(Stage.write_seconds, pause)
        self.awaited = outside_sets.AWAITED if reason is None and not self._offered and not self._under_way else None
        return reason is not None or bool(self._offered)

    @property
    def _begins_with_baseline(self) -> bool:
        return self._next == 0 and bool(self._problem.start_sets)

    def _end_before(self, number: int) -> SearchEnd | None:
        """As of other searches; the order of answers may decide."""
        return super()._end_before(number) or ("stagnation" if self._search.stood_still_at is not None else None)

    def _ask(self) -> Round | None:
        """Returns the next round of sets, or the next set to confirm after the end of the search."""
        if self._search.ended_by is not None:
            return None if self._under_way else self._confirm()
        problem, number = self._problem, self._next
        if self._begins_with_baseline:
            self._offered, population = (), problem.start_indices
        else:
            population = np.array([each.indices for each in self._offered], dtype=np.int64)
        wanted = [None] * len(population) if not self._offered else [each.scenarios for each in self._offered]
        most = [each.replicates for each in self._offered] or [1] * len(population)
        cells = [
            (individual, place, seed)
            for seed in range(1, max(most) + 1)
            for individual, listed in enumerate(wanted)
            for place, name in enumerate(problem.scenarios)
            if seed <= most[individual] and (listed is None or name in listed)
        ]
        sets = problem.space.parameter_sets(population)
        self._asked[number] = AskedRound(population, np.ones(len(population), dtype=np.bool_), cells, {})
        self._next += 1
        purpose = Purpose.SEARCH if self._offered else Purpose.START
        requested = [
            RequestedCell(individual, problem.scenarios[place], sets[individual], purpose=purpose, seed=seed)
            for individual, place, seed in cells
        ]
        return Round(number, self._benches.with_cells(requested), self._policy())

    def _form_lots(self, connection: Connection, asked: Round, planned: list[RequestedCell]) -> list[RequestedCell]:
        """Cuts the round to what room and budget allow, before a set that was cancelled a moment ago."""
        if asked.number >= self._next:  # a set to confirm
            return planned
        round_ = self._asked[asked.number]
        if planned and planned[0].seed > 1:  # the first seed has decided which sets are asked for
            kept = [cell for cell in planned if cell.individual < len(round_.population)]
            return super()._form_lots(connection, asked, kept)
        if self._offered:
            held = outside_sets.hold(connection, self._campaign.sequence, [each.number for each in self._offered])
            planned = [cell for cell in planned if cell.individual < held]
        kept = self._cut(planned)
        sets = kept[-1].individual + 1 if kept else 0
        self._most = min(MOST_SETS, 2 * self._most) if len(kept) == len(planned) else max(self._ahead, 2 * sets)
        self._offered = self._offered[:sets]
        self._asked[asked.number] = replace(round_, population=round_.population[:sets], changed=round_.changed[:sets])
        return super()._form_lots(connection, asked, kept)

    @property
    def _cells_left(self) -> float:
        return self._tracker.budget.left

    def _within_budget(self, asked: Round, planned: list[RequestedCell]) -> list[RequestedCell]:
        """Returns the cells: they were cut before their lots were formed."""
        del asked
        return planned

    def _cut(self, planned: list[RequestedCell]) -> list[RequestedCell]:
        """Returns the cells of the first sets; at least one set, unless the budget does not suffice for it."""
        left, ahead, first = self._cells_left, self._ahead, 0
        runs = [each.replicates for each in self._offered]
        for position, cell in enumerate(planned):
            if cell.individual != planned[first].individual:
                first = position
            needed = runs[cell.individual] if runs else 1
            if cell.answered_at_once and cell.plan is Outcome.REPEATED:  # another copy may have to be simulated
                needed -= 1
            left, ahead = left - needed, ahead - needed
            if needed == 0:
                continue
            if left < 0:
                self._end_search("budget")
                return planned[:first]
            if ahead < 0 and first > 0 and self._offered:
                return planned[:first]
        return planned

    def _store(self, connection: Connection, asked: Round) -> None:
        super()._store(connection, asked)
        if asked.number < self._next and self._offered:
            numbers = [each.number for each in self._offered]
            outside_sets.place(connection, self._campaign.sequence, asked.number, numbers)
            self._offered = ()

    def _close(self, number: int) -> None:
        super()._close(number)
        self._forget(number)

    def _save(self, connection: Connection) -> None:
        super()._save(connection)
        outside_sets.number_answers(connection, self._campaign.sequence, self._closed)

    def _conclude(self) -> None:
        with self._database.transaction() as connection:
            self._save(connection)

"""The search of a campaign whose sets another program proposes: rounds are the sets that wait, as far as workers and budget suffice.

Sets that no round has asked for yet can be cancelled, so that rounds take only as many cells as keep the workers busy. Cells that the
reference table answers cost nothing and do not count.
"""

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from sqlalchemy import Connection

from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.stages.answers import CellAnswers, asked_rounds
from drivecal.campaigns.stages.asking import WINDOW, AskedRound
from drivecal.campaigns.stages.search import SearchStage
from drivecal.campaigns.stages.stage import Round, Stage, Wait
from drivecal.contracts.campaign import SearchEnd
from drivecal.domain.evaluations import Outcome, Purpose, RequestedCell
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.outside import answers
from drivecal.storage.outside import sets as outside_sets
from drivecal.storage.outside.sets import OutsideSet

LOOK_SECONDS, LONGEST_LOOK = 0.05, 1.0
"""Interval (s) of checks for new sets, and of transactions with results: a tenth of the time without a set, between these."""
MOST_SETS = 1_000
"""Sets of a round."""


class OutsideSearch(SearchStage):
    """The first round is the baseline, if there is one. The search ends by its budget, or when the campaign is asked to finish and every
    set is answered. No round waits for the answers of another one."""

    asks_ahead = True
    kind_of_answers = CellAnswers
    _answers: CellAnswers

    def __init__(self, database: Database, campaign: StoredCampaign, problem: CalibrationProblem, view: View) -> None:
        super().__init__(database, campaign, problem, view)
        self._ahead = WINDOW * self._search.room
        """Cells that may wait for workers."""
        self._most = self._ahead
        """Sets that the next round tries to ask for: fewer after a cut, because each set is looked up again."""
        self._offered: Sequence[OutsideSet] = ()
        self._look_at, self._fed_at = 0.0, time.monotonic()
        self._seen: Wait = "computation"
        """Result of the last look for sets."""
        with database.read() as connection:
            self._answers.take_in(connection, campaign.sequence, range(self._closed))
            rounds = asked_rounds(connection, campaign.sequence, problem.scenarios)
        for number in range(self._closed):
            self._answers.forget(number)
        self._asked = {number: asked for number, asked in enumerate(rounds) if number >= self._closed}
        self._begin()  # its optimizer may think for long

    def _may_ask(self) -> bool:
        return not self._under_way or (self._search.ended_by is None and self._tracker.waiting < self._ahead)

    def _awaited(self) -> Wait | None:
        """Waits until a set is proposed or the search ends."""
        if not self._resumed or self._search.ended_by is not None or self._begins_with_baseline:
            return None
        if time.monotonic() < self._look_at:
            return self._seen
        closes, self._offered = self._database.query(outside_sets.waiting, self._campaign.sequence, self._most)
        reason: SearchEnd | None = None
        if self._is_spent:
            reason = "budget"
        elif self._search.stood_still_at is not None:
            reason = "stagnation"
        elif closes and not self._offered:
            reason = "finished"
        if reason is not None:
            self._end_search(reason)
        elif self._offered:
            self._fed_at = time.monotonic()
        pause = min(LONGEST_LOOK, max(LOOK_SECONDS, (time.monotonic() - self._fed_at) / 10))
        self._look_at, self.write_seconds = time.monotonic() + pause, min(Stage.write_seconds, pause)
        is_over = reason is not None or bool(self._offered)
        self._seen = "computation" if is_over or self._under_way else "sets"
        return None if is_over else self._seen

    @property
    def _begins_with_baseline(self) -> bool:
        return self._next == 0 and bool(self._problem.start_sets)

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
        return Round(number, self._benches.with_cells(requested), self._problem.policy)

    def _affordable(self, connection: Connection, asked: Round, planned: list[RequestedCell]) -> list[RequestedCell]:
        """Cuts the round to what room and budget allow, before a set that was cancelled a moment ago."""
        if asked.number >= self._next:  # a set to confirm
            return planned
        round_ = self._asked[asked.number]
        if planned and planned[0].seed > 1:  # the first seed has decided which sets are asked for
            return [cell for cell in planned if cell.individual < len(round_.population)]
        if self._offered:
            held = outside_sets.hold(connection, self._campaign.sequence, [each.number for each in self._offered])
            planned = [cell for cell in planned if cell.individual < held]
        kept = self._cut(planned)
        sets = kept[-1].individual + 1 if kept else 0
        self._most = min(MOST_SETS, 2 * self._most) if len(kept) == len(planned) else max(self._ahead, 2 * sets)
        self._offered = self._offered[:sets]
        self._asked[asked.number] = replace(round_, population=round_.population[:sets], changed=round_.changed[:sets])
        return kept

    @property
    def _cells_left(self) -> float:
        return self._tracker.budget.left

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

    def _tell(self, asked: Round) -> None:
        if asked.number < self._next:
            self._close(asked.number)
            self._asked.pop(asked.number)
            self._answers.forget(asked.number)

    def _save(self, connection: Connection) -> None:
        super()._save(connection)
        answers.number(connection, self._campaign.sequence, self._closed)

    def _conclude(self) -> None:
        with self._database.transaction() as connection:
            self._save(connection)

"""A search by populations: a round is a whole population in all scenarios, and the next one is asked when all its cells are answered.

Answers may be predicted. The start population is then requested slice by slice, and the predictor learns from each.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np
from sqlalchemy import Connection

from drivecal.campaigns.cells.inspection import enters_lot, form_lots_of_references
from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.cells.predicting import CHANGED, LotPlanner, slice_size
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.stages.answers import PopulationAnswers
from drivecal.campaigns.stages.asking import WINDOW, AskedRound, PopulationAsker, population_round, room_for
from drivecal.campaigns.stages.search import ComputedSearch
from drivecal.campaigns.stages.stage import Round, Wait
from drivecal.contracts.campaign import Released
from drivecal.domain.evaluations import Outcome, RequestedCell
from drivecal.domain.events import EventKind
from drivecal.storage import events, generations, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.generations import StoredGeneration

ENDLESS = 20
"""Generations ahead of a search that no budget of simulations and no number of iterations ends."""
CONFIRMED = 3
"""Sets whose confirmation a budget is to suffice for."""


class PopulationSearch(ComputedSearch):
    """A search by a generational optimizer. A generation is one batch; with predictions or a budget of minutes it may be several."""

    window = 1
    has_populations = True
    kind_of_answers = PopulationAnswers

    def __init__(self, database: Database, campaign: StoredCampaign, problem: CalibrationProblem, view: View) -> None:
        super().__init__(database, campaign, problem, view)
        population = problem.search.population
        self._planner: LotPlanner | None = None
        if problem.policy.predicts:
            self._planner = LotPlanner(view, problem.space, problem.specification.reduction, problem.weights, population)
            self._planner.off = self._search.predictions_off
        self._has_learned = False
        """The planner knows the answers of the batch before."""
        self._changed = CHANGED * population
        """Number of sets that a generation requests: as in the last generation, or the usual number."""
        self._released: dict[str, Released] = dict(campaign.released)
        self._kept: set[int] = set()
        """Individuals of a round for which the budget suffices under the first seeds."""
        self._batches: list[list[int]] = []
        """Individuals of the current generation that have not been requested."""
        with database.read() as connection:
            last = generations.last(connection, campaign.sequence)
            populations = generations.populations(connection, campaign.sequence) if problem.search_constraints else []
            for number, indices in enumerate(populations[: self._closed]):
                self._answers.take_in(connection, campaign.sequence, [number])
                self._answers.settle(np.array(indices, dtype=np.int64))
            if not populations:
                self._answers.take_in(connection, campaign.sequence, range(self._closed))
            if last is not None:
                rows, changed = np.array(last.population, dtype=np.int64), np.array(last.changed, dtype=np.bool_)
                asked = population_round(problem, rows, changed, dict(last.optimizer_state or {}))
                self._changed = float(changed.sum()) if last.iteration else self._changed
                self._asked = {last.iteration: asked}
                here = campaign.sequence, self.name, last.iteration
                is_open = not last.finished and self._search.ended_by is None
                for batch in self._split(last.iteration, asked) if is_open else ():
                    # A cut by the budget leaves the last of a batch for later.
                    wanted = [each for each in batch if not results.is_requested(connection, *here, each)]
                    if wanted or not results.is_requested(connection, *here):
                        self._batches.append(wanted)
        if self._search.ended_by is None:
            self._compute(partial(self._restored, last, populations))

    def _restored(self, last: StoredGeneration | None, populations: Sequence[Any]) -> PopulationAsker:
        """Returns the search as it was after the `last` generation; `populations`: all so far, with constraints only."""
        chosen, problem = self._optimization, self._problem
        if last is None:
            optimizer = chosen.begin(problem.search_constraints, problem.start_indices if problem.start_sets else None)
        elif last.optimizer_state is None:
            raise RuntimeError(f"generation {last.iteration} has no optimizer state")
        else:
            optimizer = chosen.restore(problem.search_constraints, last.optimizer_state)
            populations = populations or [last.population]
        return PopulationAsker(optimizer, problem, populations)

    def _awaited(self) -> Wait | None:
        """Waits until the search has computed the next round, and what predicts its answers is loaded."""
        awaited = super()._awaited()
        if awaited is not None or self._planner is None or not self._resumed or self._search.ended_by is not None:
            return awaited
        if not self._has_learned:
            with self._view.reuse_time.counted(), self._database.read() as connection:
                self._planner.learn(connection, (self._next - 1, self._batches[0][0]) if any(self._batches) else None)
            self._has_learned = True
        iterations, each = self._optimization.iterations, max(1.0, self._changed)
        most = ENDLESS if iterations is None else iterations - self._next
        ahead = min(most, self._cells_left / len(self._problem.scenarios) / each)
        waiting = sum(map(len, self._batches)) + ahead * each
        return None if self._planner.is_ready(waiting, len(self._batches) + ahead) else "computation"

    def _ask(self) -> Round | None:
        """Returns the next batch of the round, the next round of the search, or the next one after it."""
        if self._batches:
            return self._next_batch()
        asked = self._propose()
        if asked is None:
            return self._after_search()
        if asked.repaired is not None:
            self._search = self._search.model_copy(update={"repaired": self._search.repaired + asked.repaired})
        self._batches = self._split(self._next - 1, asked)
        return replace(self._next_batch(), carried_over=asked.unchanged * len(self._problem.scenarios))

    def _split(self, number: int, asked: AskedRound) -> list[list[int]]:
        """Returns the individuals to request, in batches: the start population is learned from slice by slice if answers are predicted."""
        changed = [int(index) for index in np.flatnonzero(asked.changed)]
        if number:
            self._changed = float(len(changed))
        budget = self._optimization.budget
        is_timed = budget is not None and budget.minutes is not None and not self._view.influence_map_sequence  # maps have lots
        whole, under_way = len(asked.changed), WINDOW * room_for(self._view.workers)  # as of a search by the cell
        timed = -(-under_way // len(self._problem.scenarios)) if is_timed else whole
        learned = slice_size(self._optimization.population) if number == 0 else whole
        size = timed if self._planner is None else learned
        return [list(members) for _, members in groupby(changed, lambda index: index // size)] or [[]]

    def _next_batch(self) -> Round:
        number, batch = self._next - 1, self._batches.pop(0)
        asked = self._asked[number]
        if self._planner is not None:
            with self._database.transaction() as connection:
                self._answers.take_in(connection, self._campaign.sequence, [number])
            sets = self._problem.space.parameter_sets(asked.population[batch])
            self._planner.predict(dict(zip(batch, sets, strict=True)))
            self._has_learned = False
        return Round(number, self._cells(asked, batch), self._problem.policy)

    def _tell(self, asked: Round) -> None:
        if asked.number >= self._next or self._batches:
            return
        if self._planner is not None:
            with self._view.reuse_time.counted(), self._database.read() as connection:
                self._released = self._planner.released(connection)
        self._close(asked.number)
        self._go_on()

    def _form_lots(self, connection: Connection, asked: Round, planned: list[RequestedCell]) -> list[RequestedCell]:
        if asked.number >= self._next:
            return planned
        limit = self._problem.specification.reduction.max_error
        planned = form_lots_of_references(connection, self._view, planned, limit, self._error_rate)
        if self._planner is not None:
            if self._planner.off is not None and self._search.predictions_off is None:
                events.add(connection, self._campaign.sequence, EventKind.NOTE, {"text": self._planner.off})
            self._search = self._search.model_copy(update={"predictions_off": self._planner.off})
            given = range(len(self._problem.start_sets)) if asked.number == 0 else ()
            best, reaches = self._surest()
            planned = self._planner.plan(connection, planned, best, given, reaches)
        return planned

    def _surest(self) -> tuple[float | None, Any]:
        """Returns the best simulated objective, and, unless it is the weighted score, what judges whether a set may reach the front."""
        best = self._ranking.surest()
        reaches = None if self._problem.goals.is_weighted_score else self._ranking.reaches_front
        return None if best is None else best.objective, reaches

    def _affordable(self, connection: Connection, asked: Round, planned: list[RequestedCell]) -> list[RequestedCell]:
        """Returns the first cells for which the budget suffices, without parts of individuals, and ends the search if there are none. An
        individual runs under all seeds of a round or none. Cells without a stored answer count, and reused cells that will enter
        a lot: workers simulate rejected lots, too. What lots save is known with their verdicts, so the other individuals wait for these."""
        del connection
        if asked.number >= self._next:
            return planned
        seeds, reduction = [bench.seed for bench, _ in asked.cells], self._problem.specification.reduction
        place, within = seeds.index(planned[0].seed) if planned else 0, list(planned)
        room = 0 if self._is_late and not place else self._cells_left
        outcomes = {cell.plan for cell in planned} | {name for name, count in self._tracker.counts.items() if count}
        if outcomes & {Outcome.PREDICTED, Outcome.REUSED}:  # may confirm the best set
            room -= min(min(reduction.confirm, CONFIRMED) * len(self._problem.scenarios), (self._limit or 0) // 10)
        if place:
            within = [cell for cell in planned if cell.individual in self._kept]
        wanted = {cell.individual for cell in within}
        following = len(seeds) - place - 1  # stored results of this seed say nothing of the next ones
        for number, cell in enumerate(within):
            room -= following + (not cell.answered_at_once or enters_lot(cell, reduction.max_error))
            if room < 0:
                within = [each for each in within[:number] if each.individual != cell.individual]
                break
        self._kept = {cell.individual for cell in within}
        later = sorted(wanted - self._kept)
        if later and self._kept and not place:
            self._batches.insert(0, later)
        elif later:
            self._end_search("budget")
            self._batches.clear()
        return within

    def _last_look(self, limit: int) -> list[int]:
        dismissed = self._ranking.dismissed()
        if self._planner is None or not dismissed:
            return []
        with self._view.reuse_time.counted(), self._database.read() as connection:
            return self._planner.worth_a_look(connection, dismissed, *self._surest())[: limit // 4]

    def _snapshot(self, connection: Connection) -> StoredCampaign:
        return replace(super()._snapshot(connection), released=self._released)

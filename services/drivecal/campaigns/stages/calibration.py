"""The calibration stage: asks the search, plans the cells of each round, stores the answers and returns them to the search.

A round of a generational optimizer is an iteration, which is answered before the next one is asked. Of a search by the cell, several rounds
are under way: round n knows the answers of the rounds up to n - WINDOW and nothing else.

On request, later rounds confirm the best set (`confirmation`). Their cells continue the stage's iteration numbers, without a generation.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from sqlalchemy import Connection

from drivecal.analysis.confirmation import Confirming, front_outcome
from drivecal.analysis.verdicts import confirmation_verdict
from drivecal.campaigns.cells.inspection import check_reuse, form_lots_of_references, rejected_text
from drivecal.campaigns.cells.planning import View, sync_reference_keys
from drivecal.campaigns.cells.predicting import CHANGED, LotPlanner, slice_size
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.resolve.resolvers import note_predictions
from drivecal.campaigns.stages import task
from drivecal.campaigns.stages.answers import CellAnswers, PopulationAnswers
from drivecal.campaigns.stages.asking import (
    WINDOW,
    AskedRound,
    Asker,
    CellAsker,
    Computation,
    cells_of,
    population_round,
    room_for,
)
from drivecal.campaigns.stages.leader import Leader
from drivecal.campaigns.stages.replication import Replication, SeededBenches
from drivecal.campaigns.stages.stage import Round, Stage
from drivecal.contracts.campaign import CellCounts, ErrorRate, Released, Repaired, SearchEnd, SearchState
from drivecal.contracts.tables import Generation
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import NoResultError
from drivecal.domain.evaluations import Purpose, RequestedCell
from drivecal.domain.events import EventKind
from drivecal.execution.scheduling.in_flight import Work
from drivecal.optimizers.repair import RepairCount
from drivecal.plugins.ports import Floats
from drivecal.plugins.search import AskedCell, CellAnswer
from drivecal.reduction.assignment import Policy
from drivecal.storage import evaluations, events, generations, results
from drivecal.storage.campaigns import Snapshot, StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.generations import StoredGeneration
from drivecal.storage.references import parameter_sets

ENDLESS = 20
"""Generations ahead of a search that no budget of simulations and no number of iterations ends."""
CONFIRMED = 3
"""Sets whose confirmation a budget is to suffice for."""


class Calibration(Stage):
    """The search of a campaign: its rounds, and after the last one sets to confirm."""

    name = StageName.CALIBRATION
    uses_map = True

    def __init__(self, database: Database, campaign: StoredCampaign, problem: CalibrationProblem, view: View) -> None:
        if problem.optimization is None:
            raise ValueError("the campaign has no calibration stage")
        super().__init__(database, campaign, view)
        self._problem, self._optimization = problem, problem.optimization
        self._by_cell = problem.optimization.by_cell
        self._answers: PopulationAnswers | CellAnswers = (
            PopulationAnswers(problem, problem.optimization.population) if self._by_cell is None else CellAnswers(problem)
        )
        self._window = 1 if self._by_cell is None else WINDOW
        self.asks_ahead = self._by_cell is not None
        self._ranking = self._answers.ranking
        self._leader = Leader(campaign, problem, self._ranking)
        self._error_rate: dict[str, ErrorRate] = dict(campaign.error_rate)
        self._notes = problem.notes
        if campaign.search is not None:
            view.reuse_time.seconds += campaign.search.reuse_seconds
        self._repeatable_no_more = campaign.cells.unrepeatable > 0
        begun, room = campaign.search, room_for(view.workers)
        self._search = SearchState(room=room, began_at=now()) if begun is None else begun.resumed(now())
        self._asker: Asker | None = None
        self._computation: Computation | None = None
        """The search's running computation; None if the next round needs none."""
        self._asked: dict[int, AskedRound] = {}
        """Rounds that the search was not told, by number."""
        self._next = self._closed = 0
        """Numbers of rounds that were asked, and of rounds that are answered."""
        self._begun = False
        self._batches: list[list[int]] = []
        """Individuals of the current generation that have not been requested."""
        self._planner: LotPlanner | None = None
        if self._by_cell is None and self._policy().predicts:
            reduction, population = problem.specification.reduction, problem.optimization.population
            self._planner = LotPlanner(view, problem.space, reduction, problem.weights, population)
            self._planner.off = self._search.predictions_off
        self._has_learned = False
        """The planner knows the answers of the batch before."""
        self._changed = CHANGED * self._optimization.population
        """Number of sets that a generation requests: as in the last generation, or the usual number."""
        self._released: dict[str, Released] = dict(campaign.released)
        self._confirming: Confirming | None = None
        """The sets that are simulated after the search; None before its end."""
        self._confirmation = campaign.confirmation
        self._limit = None if problem.optimization.budget is None else problem.optimization.budget.simulations
        self._within = problem.search_simulations() or 0
        if self._limit is not None:
            most = 0 if self._by_cell is None else task.most_cells(self._within, problem.bench.repeated_share)
            self._tracker.limit(self._limit, most)
            self.budget = self._tracker.budget
        self._kept: set[int] = set()  # individuals of a round for which the budget suffices
        self._benches = SeededBenches(problem.bench)
        self._replication = Replication(problem, self._answers, self._benches)

    @property
    def _at_most(self) -> int:
        return 0 if self._search.ended_by is not None else self._problem.expected_runs().calibration_at_most

    def _may_ask(self) -> bool:
        return not self._under_way or self._computation is not None

    def _ask(self) -> Round | None:
        """The next batch of the round, the next round of the search, or the next set to confirm."""
        if self._batches:
            return self._next_batch()
        if self._computation is not None and (asked := self._propose()) is not None:
            return asked
        if self._under_way:
            return None
        asked = None if self._problem.bench.is_random else self._confirm()
        if asked is None:
            asked = self._replicate()
        if asked is None and self._ranking.best() is None:
            failed = CellCounts(**self._tracker.counts).failed
            raise NoResultError(f"no parameter set has a result in every scenario; {failed:,} cells failed{self._causes()}")
        return asked

    def _tell(self, asked: Round) -> None:
        if asked.number < self._next and not self._batches:
            self._close(asked.number)

    def _is_ready(self) -> bool:
        """Returns whether the search has computed the next round, and what predicts its answers is loaded."""
        if not self._begun:
            self._begin()
            self._begun = True
        if self._computation is not None and not self._computation.is_done:
            return False
        if self._planner is None or not self._resumed or self._search.ended_by is not None:
            return True
        if not self._has_learned:
            with self._view.reuse_time.counted(), self._database.transaction() as connection:
                self._planner.learn(connection)
            self._has_learned = True
        iterations, each = self._optimization.iterations, max(1.0, self._changed)
        most = ENDLESS if iterations is None else iterations - self._next
        generations = min(most, self._cells_left / len(self._problem.scenarios) / each)
        waiting = sum(map(len, self._batches)) + generations * each
        return self._planner.is_ready(waiting, len(self._batches) + generations)

    def _begin(self) -> None:
        """Reads the rows, and begins to restore the search as it was after the last round, or to create one."""
        with self._view.reuse_time.counted():
            sync_reference_keys(self._database, self._view)
        with self._database.read() as connection:
            last = generations.last(connection, self._campaign.sequence)
            self._closed = generations.finished(connection, self._campaign.sequence)
            constrained = self._by_cell is None and bool(self._problem.search_constraints)
            populations = generations.populations(connection, self._campaign.sequence) if constrained else []
            for number, population in enumerate(populations[: self._closed]):
                self._answers.take_in(connection, self._campaign.sequence, [number])
                self._answers.settle(np.array(population, dtype=np.int64))
            if not constrained:
                self._answers.take_in(connection, self._campaign.sequence, range(self._closed))
            self._next = 0 if last is None else last.iteration + 1
            told = max(0, self._next - self._window)
            rounds = (
                [] if self._by_cell is None else task.asked_rounds(connection, self._campaign.sequence, self._problem.scenarios)
            )
        self._asked = {number: asked for number, asked in enumerate(rounds) if number >= told}
        if last is not None and self._by_cell is None:
            rows, changed = np.array(last.population, dtype=np.int64), np.array(last.changed, dtype=np.bool_)
            self._changed = float(changed.sum()) if last.iteration else self._changed
            shape = len(self._problem.scenarios), self._problem.least_replicates
            self._asked = {last.iteration: population_round(rows, changed, dict(last.optimizer_state or {}), *shape)}
            self._batches = [] if last.finished else self._split(last.iteration, self._asked[last.iteration])
        if self._search.ended_by is not None:
            return
        if isinstance(self._answers, CellAnswers):
            answers = [self._answers.for_search(number, rounds[number])[0] for number in range(told)]
            asked = [cells_of(asked, self._problem.least_replicates) for asked in rounds]
            self._compute(partial(self._cell_asker, asked, answers, last))
        else:
            self._compute(partial(task.population_asker, self._problem, last, populations))

    def _cell_asker(
        self, rounds: Sequence[Sequence[AskedCell]], answers: Sequence[Sequence[CellAnswer]], last: StoredGeneration | None
    ) -> CellAsker:
        plugin, settings = self._by_cell, self._optimization.settings
        if plugin is None or not isinstance(self._answers, CellAnswers):
            raise RuntimeError("the search is no search by the cell")
        searched = task.search_task(self._database, self._view, self._problem, self._answers)
        state = {} if last is None else (last.optimizer_state or {}).get("search", {})
        search = plugin.begin(settings, searched) if last is None else plugin.resume(settings, searched, rounds, answers, state)
        return CellAsker(search, self._search.room, self._problem.least_replicates)

    def _compute(self, obtain: Callable[[], Asker]) -> None:
        """Begins to obtain the search, and to ask it for the next round if that may be asked for."""
        number = self._next
        is_due = number < self._window or self._closed > number - self._window
        reason = self._end_before(number) if is_due else None
        if reason is not None:
            self._end_search(reason)
        asks = is_due and reason is None
        if reason is not None or (self._asker is not None and not asks):
            return
        told = None
        if asks and number >= self._window:
            told = self._answers.for_search(number - self._window, self._asked.pop(number - self._window))
        self._computation = Computation(obtain, told, asks=asks)

    def _go_on(self) -> None:
        """Begins to compute the next round, if it is time."""
        asker = self._asker
        if asker is not None and self._computation is None and self._search.ended_by is None:
            self._compute(lambda: asker)

    def _end_before(self, number: int) -> SearchEnd | None:
        """Returns why the search ends before a round; None if it goes on. Knows the rounds that the search knows, and the clock."""
        budget, search = self._optimization.budget, self._search
        if self._optimization.iterations is not None and number >= self._optimization.iterations:
            return "iterations"
        if budget is None or number == 0:
            return None
        if budget.minutes is not None and search.minutes(now()) >= budget.minutes:
            return "budget"
        if budget.simulations is not None and self._cells_left < 1:
            return "budget"
        return "stagnation" if search.stood_still_at is not None and search.stood_still_at <= number - self._window else None

    def _end_search(self, reason: SearchEnd) -> None:
        """Notes the end, which is stored with the next rows."""
        minutes = self._search.minutes(now())
        self._search = self._search.model_copy(update={"ended_by": reason, "spent_minutes": minutes})

    def _resume(self) -> list[Work]:
        """Resumes the rounds that have cells without an answer, or starts with the first, once the search is restored.

        A replay may take long, so that no transaction is open meanwhile. What was read before stays true: only the dispatcher changes it,
        and every transaction first checks that this process is still the one.
        """
        if self._computation is not None and not self._computation.asks:
            (self._asker, _), self._computation = self._computation.result(), None
        with self._database.transaction() as connection:
            if self._next == 0:
                self._leader.remember_baseline(connection)
                return self._tracker.load(connection, share_runs=self._policy().mode != "off")
            here = connection, self._campaign.sequence, self.name, self._next - 1
            self._batches = [each for each in self._batches if not results.is_requested(*here, each[0] if each else None)]
            seeds = {cell.seed for cell in results.pending(connection, self._campaign.sequence)}
            benches = [self._benches.of(seed) for seed in sorted(seeds)]
            work = self._tracker.load(connection, share_runs=self._policy().mode != "off", benches=benches)
            self._save(connection)
        for number in range(self._closed, self._next):
            self._round = Round(number, (), self._policy())
            self._under_way.append(self._round)
        return work

    def _propose(self) -> Round | None:
        """Returns the next round of the search; None if it has nothing left to ask for."""
        if self._computation is None:
            raise RuntimeError("the stage has not started")
        (self._asker, asked), self._computation = self._computation.result(), None
        if asked is None:
            set_cells = len(self._problem.scenarios) * self._problem.least_replicates
            self._end_search("budget" if self._cells_left < set_cells else "stagnation")
            return None
        number, self._next = self._next, self._next + 1
        self._asked[number] = asked
        if asked.repaired is not None:
            self._count_repaired(asked.repaired)
        self._tracker.note_discarded(asked.state.get("discarded", 0) if self._by_cell is not None else 0)
        self._batches = self._split(number, asked)
        requested = replace(self._next_batch(), carried_over=self._carried_over(asked))
        self._go_on()
        return requested

    def _count_repaired(self, count: RepairCount) -> None:
        total = RepairCount(self._search.repaired.proposed, self._search.repaired.distinct) + count
        repaired = Repaired(proposed=total.proposed, distinct=total.distinct)
        self._search = self._search.model_copy(update={"repaired": repaired})

    def _carried_over(self, asked: AskedRound) -> int:
        """Returns the number of cells of a round that keep earlier answers."""
        return int((~asked.changed).sum()) * len(self._problem.scenarios)

    def _split(self, number: int, asked: AskedRound) -> list[list[int]]:
        """Returns the individuals to request, in batches: the start population is learned from slice by slice if answers are predicted."""
        changed = [int(index) for index in np.flatnonzero(asked.changed)]
        if number:
            self._changed = float(len(changed))
        size = slice_size(self._optimization.population) if self._planner is not None and number == 0 else len(changed)
        return [changed[start : start + size] for start in range(0, len(changed), size)] if changed else [[]]

    def _next_batch(self) -> Round:
        number = self._next - 1
        asked, batch, problem = self._asked[number], self._batches.pop(0), self._problem
        sets = dict(zip(batch, problem.space.parameter_sets(asked.population[batch]), strict=True))
        purposes = {number: Purpose.START if each in problem.start_sets else Purpose.SEARCH for number, each in sets.items()}
        wanted = [
            RequestedCell(individual, problem.scenarios[place], sets[individual], purpose=purposes[individual], seed=seed)
            for individual, place, seed in asked.cells
            if individual in sets
        ]
        if self._planner is not None:
            with self._database.transaction() as connection:
                self._answers.take_in(connection, self._campaign.sequence, [number])
            self._planner.predict(sets)
            self._has_learned = False
        before = None if self._by_cell is None else number - self._window + 1
        return Round(number, self._benches.with_cells(wanted), self._policy(), before=before)

    def _form_lots(self, connection: Connection, asked: Round, planned: list[RequestedCell]) -> list[RequestedCell]:
        if asked.number >= self._next:
            return planned
        limit = self._problem.specification.reduction.max_error
        rates = self._error_rate if self._by_cell is None else {}  # known at another moment in each run
        planned = form_lots_of_references(connection, self._view, planned, limit, rates)
        if self._planner is not None:
            if self._planner.off is not None and self._search.predictions_off is None:
                events.add(connection, self._campaign.sequence, EventKind.NOTE, {"text": self._planner.off})
            self._search = self._search.model_copy(update={"predictions_off": self._planner.off})
            best = self._ranking.surest()
            given = range(len(self._problem.start_sets)) if asked.number == 0 else ()
            reaches = None if self._problem.goals.is_weighted_score else self._ranking.reaches_front
            planned = self._planner.plan(connection, planned, None if best is None else best.objective, given, reaches)
        return self._within_budget(asked, planned)

    @property
    def _cells_left(self) -> float:
        """Cells that the search may ask for; infinite without a budget of simulations."""
        budget, varies = self._tracker.budget, self._tracker.counts.get("unrepeatable", 0) > 0
        within = self._problem.search_simulations(varies=varies) or 0
        left = budget.left - ((self._limit or 0) - within)
        return left if self._by_cell is None or math.isinf(left) else min(left, budget.kept - (self._within - within))

    def _within_budget(self, asked: Round, planned: list[RequestedCell]) -> list[RequestedCell]:
        """Returns the first cells for which the budget suffices; the search ends with them if it does not for all."""
        by_cell, reduction, room = self._by_cell is not None, self._problem.specification.reduction, self._cells_left
        if not by_cell and self._policy().mode not in {"off", "exact"}:  # may confirm the best set
            room -= min(min(reduction.confirm, CONFIRMED) * len(self._problem.scenarios), (self._limit or 0) // 10)
        within = task.affordable(planned, room, [bench.seed for bench, _ in asked.cells], self._kept, by_cell=by_cell)
        if len(within) < len(planned):
            self._end_search("budget")
            self._batches.clear()
        return within

    def _policy(self) -> Policy:
        return self._problem.policy

    def _store(self, connection: Connection, asked: Round) -> None:
        """Commits a round with the search's state and its cells; a set to confirm belongs to no generation."""
        if asked.number >= self._next:
            return
        if generations.is_stored(connection, self._campaign.sequence, asked.number):  # with an earlier batch
            return
        round_ = self._asked[asked.number]
        generations.insert(
            connection,
            self._campaign.sequence,
            Generation(iteration=asked.number, carried_over=self._carried_over(round_)),
            population=round_.population.tolist(),
            changed=round_.changed.tolist(),
            optimizer_state=round_.state,
        )
        if asked.number == 0:
            self._record_beginning(connection)

    def _confirm(self) -> Round | None:
        """The best set in the scenarios with scores copied from references, after the previous answers; None when no set is left."""
        sequence, first = self._campaign.sequence, self._next
        limit, best = self._problem.specification.reduction.confirm, self._ranking.best()
        believed = self._ranking.doubtful() if best is None else best[0]  # every set may have a predicted score
        if limit and self._search.last_look is None:
            self._search = self._search.model_copy(update={"last_look": self._last_look(limit)})
        if limit == 0 or believed is None:
            with self._database.transaction() as connection:
                self._save(connection)  # what is noted at the end of a search
            return None
        with self._database.transaction() as connection:
            if self._confirming is None:
                tried = results.sets_since(connection, sequence, self.name, first)
                last_look = self._search.last_look or []
                self._confirming, taken = Confirming(limit, believed.objective, tried, last_look), 0
            else:
                tried, taken = self._confirming.tried, len(self._confirming.tried) - 1
            for number in range(taken, len(tried)):
                self._answers.add(self._answers.read(connection, sequence, first + number))
            if tried:
                self._leader.describe(connection)
            chosen = self._confirming.choose(self._ranking)
            if chosen is not None and len(chosen.reused) > self._tracker.budget.left:
                chosen = None
            if chosen is None:
                self._end_confirmation(connection, self._confirming)
            else:
                parameters = parameter_sets.load(connection, [chosen.parameter_set])[chosen.parameter_set]
            self._save(connection)
        if chosen is None:
            return None
        wanted = [RequestedCell(0, scenario, parameters, purpose=Purpose.CONFIRMATION) for scenario in chosen.reused]
        tried.append(chosen.parameter_set)
        return Round(first + len(tried) - 1, [(self._problem.bench, wanted)], Policy("exact"))

    def _last_look(self, limit: int) -> list[int]:
        """Returns the ids of dismissed sets that all answers together believe within reach of the best set."""
        dismissed = self._ranking.dismissed()
        if self._planner is None or not dismissed:
            return []
        surest = self._ranking.surest()
        reaches = None if self._problem.goals.is_weighted_score else self._ranking.reaches_front
        best = None if surest is None else surest.objective
        with self._view.reuse_time.counted(), self._database.transaction() as connection:
            return self._planner.worth_a_look(connection, dismissed, best, reaches)[: limit // 4]

    def _replicate(self) -> Round | None:
        """The runs under further seeds, after the previous answers, that decide which set is the best; None if it is decided, the budget
        is used up, or no run is random."""
        if not self._problem.bench.is_random and not self._tracker.counts.get("unrepeatable"):
            return None
        with self._database.transaction() as connection:
            asked = self._replication.ask(connection, self._campaign.sequence, self._next, self._search.room, self._tracker)
            self._leader.describe(connection)
            self._save(connection)
        return asked

    def _end_confirmation(self, connection: Connection, confirming: Confirming) -> None:
        """Stores the outcome of the confirmation, once; its simulations may contradict others."""
        best = self._ranking.best()
        dismissed = len(self._ranking.dismissed())
        if (confirming.tried or dismissed) and best is not None:
            last, scenarios = self._next - 1, self._problem.scenarios
            self._error_rate = check_reuse(connection, self._view, last, scenarios, self._error_rate)
            if self._confirmation is None:
                is_front, untried = self._problem.goals.is_vector, self._ranking.doubtful(confirming.tried)
                front = self._ranking.front() if is_front else []
                if is_front and (not best[0].reused or any(member.solution.reused for member in front)):
                    outcome = front_outcome(front, confirming.tried, untried)
                else:
                    outcome = confirming.outcome(best[0], untried)
                self._confirmation = outcome.model_copy(update={"dismissed": dismissed})
                text = confirmation_verdict(self._confirmation).text
                events.add(connection, self._campaign.sequence, EventKind.NOTE, {"text": text})
                if not is_front and confirming.tried and confirming.is_changed(best[0]):
                    self._leader.record_event(connection, best[0])

    def _close(self, number: int) -> None:
        """Closes a round: every cell has its answer."""
        asked = self._asked[number]
        with self._database.transaction() as connection:
            sets = self._ranking.sets
            self._answers.take_in(connection, self._campaign.sequence, [number])
            self._answers.settle(asked.population)
            objectives = self._answers.objectives(number)
            with self._view.reuse_time.counted():
                self._error_rate = check_reuse(connection, self._view, number, self._problem.scenarios, self._error_rate)
                if self._planner is not None:
                    self._released = self._planner.released(connection)
            is_better = self._leader.describe(connection) or self._answers.has_better_variant()
            figures = self._figures(connection, number, asked, objectives)
            is_new = self._ranking.sets > sets
            self._search = task.progressed(
                self._search, figures, self._optimization, number, is_better=is_better, is_new=is_new
            )
            generations.finish(connection, self._campaign.sequence, figures, objectives.tolist())
            self._closed = number + 1
            self._save(connection)
            data = {"iterations": self._optimization.iterations, **figures.model_dump()}
            events.add(connection, self._campaign.sequence, EventKind.GENERATION, data)
        self._go_on()
        if self._by_cell is None and self._computation is None:
            self._asked.pop(number)

    def _figures(self, connection: Connection, number: int, asked: AskedRound, objectives: Floats) -> Generation:
        cells = evaluations.counts(connection, self._campaign.sequence, self.name, number)
        carried_over = self._carried_over(asked)
        cells = cells.model_copy(update={"carried_over": carried_over, "proposed": cells.requested + carried_over})
        return self._answers.figures(number, cells, objectives)

    def _record_beginning(self, connection: Connection) -> None:
        events.add(connection, self._campaign.sequence, EventKind.STAGE, {"stage": self.name, "cells": self._at_most})
        for note in self._notes:
            if note not in self._campaign.notes:  # the sensitivity stage has recorded those
                events.add(connection, self._campaign.sequence, EventKind.NOTE, {"text": note})

    def _snapshot(self, connection: Connection) -> Snapshot:
        counts = CellCounts(**self._tracker.counts)
        notes = list(self._notes)
        if (rejected := rejected_text(self._error_rate)) is not None:
            notes.append(rejected)
        if counts.unrepeatable:
            advice = note_predictions(self._problem.specification, self._problem.bench.scale)  # holds for equal runs
            notes = [note for note in notes if note not in advice]
            notes.append(f"runs that differ from another one of the same cell: {counts.unrepeatable}; scores are samples")
            if not self._repeatable_no_more:
                events.add(connection, self._campaign.sequence, EventKind.NOTE, {"text": notes[-1]})
                self._repeatable_no_more = True
        notes += self._score_notes()
        repaired = self._search.repaired
        if RepairCount(repaired.proposed, repaired.distinct).collapses:
            notes.append(
                f"{repaired.proposed:,} proposals broke constraints and became {repaired.distinct:,} new sets: the search hardly moves;"
                " choose another optimizer, or loosen the constraints"
            )
        is_over = self._search.ended_by is not None
        reuse = 0.0 if self._policy().mode == "off" else self._view.reuse_time.seconds
        if is_over and self._search.predictions_off is not None:
            notes.append(self._search.predictions_off)
        if is_over:
            notes += self._leader.notes()
        return replace(
            super()._snapshot(connection),
            iteration=self._next - 1 if self._next else None,
            search=self._search.model_copy(
                update={"reuse_seconds": reuse, "spent_minutes": self._search.minutes(now()), "surest": self._leader.surest}
            ),
            progress=self._progress(counts.requested, counts.requested + counts.pending),
            error_rate=self._error_rate,
            released=self._released,
            best=self._leader.best,
            confirmation=self._confirmation,
            baseline=self._leader.baseline,
            notes=tuple(notes),
        )

"""The common part of all searches: rounds and the ranking of their sets, the end by a budget, and the confirmation of the best set.

Cells of the confirmation continue the stage's iteration numbers, without a generation.
"""

import time
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import ClassVar

from sqlalchemy import Connection

from drivecal.analysis.confirmation import Confirming, front_outcome
from drivecal.analysis.verdicts import confirmation_verdict
from drivecal.campaigns.cells.inspection import check_reuse, notes_on_lots
from drivecal.campaigns.cells.planning import View, sync_reference_keys
from drivecal.campaigns.resolve.bench import Bench
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.resolve.resolvers import note_predictions
from drivecal.campaigns.stages.answers import SearchAnswers
from drivecal.campaigns.stages.asking import AskedRound, Asker, Computation, room_for
from drivecal.campaigns.stages.leader import Leader
from drivecal.campaigns.stages.replication import Replication, SeededBenches
from drivecal.campaigns.stages.stage import Round, Stage, Wait
from drivecal.contracts.campaign import CellCounts, ErrorRate, GenerationCounts, SearchEnd, SearchState
from drivecal.contracts.specification import ReductionSpecification
from drivecal.contracts.tables import Generation
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import NoResultError
from drivecal.domain.evaluations import Purpose, RequestedCell
from drivecal.domain.events import EventKind
from drivecal.execution.scheduling.in_flight import Completed, Work
from drivecal.storage import evaluations, events, generations, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import parameter_sets

STALE = 50
"""Generations without a new set after which a search with a budget ends: its space is exhausted, or its population stands still."""


class SearchStage(Stage):
    """The search of a campaign: its rounds, and after the last one sets to confirm."""

    name = StageName.CALIBRATION
    uses_map = True
    has_populations: ClassVar[bool] = False
    kind_of_answers: ClassVar[type[SearchAnswers]]
    _problem: CalibrationProblem

    def __init__(self, database: Database, campaign: StoredCampaign, problem: CalibrationProblem, view: View) -> None:
        super().__init__(database, campaign, problem, view)
        self._optimization, self._answers = problem.search, self.kind_of_answers(problem)
        self._ranking = self._answers.ranking
        self._leader = Leader(campaign, problem, self._ranking)
        self._error_rate: dict[str, ErrorRate] = dict(campaign.error_rate)
        if campaign.search is not None:
            view.reuse_time.seconds += campaign.search.reuse_seconds
        self._repeatable_no_more = campaign.cells.unrepeatable > 0
        begun, room = campaign.search, room_for(view.workers)
        self._search = SearchState(room=room) if begun is None else begun
        spent = self._search.spent_minutes or 0.0
        self._since = time.monotonic() - 60 * spent if spent else None
        """Begin of the search if it never paused, on a clock that cannot be set (s); None before its first run: workers may still start."""
        self._asked: dict[int, AskedRound] = {}
        """Rounds whose answers the search does not know, by number."""
        self._confirming: Confirming | None = None
        """The sets that are simulated after the search; None before its end."""
        self._confirmation = campaign.confirmation
        self._closing: int | None = 0
        """Cells that the runs after the search may still ask for to choose the best of random ones; None while unknown."""
        self._limit = None if problem.search.budget is None else problem.search.budget.simulations
        if self._limit is not None:
            self._tracker.limit(self._limit)
            self.budget = self._tracker.budget
        self._benches = SeededBenches(problem.bench)
        with view.reuse_time.counted():
            sync_reference_keys(database, view)
        with database.read() as connection:
            last = generations.last(connection, campaign.sequence)
            self._closed = generations.finished(connection, campaign.sequence)
        self._next = 0 if last is None else last.iteration + 1
        """Number of rounds that were asked; `_closed` of them are answered."""

    @property
    def _at_most(self) -> int:
        varies = self._problem.bench.is_random or self._tracker.counts.get("unrepeatable", 0) > 0
        goes_on = self._search.ended_by is None or (varies and self._closing is None)
        return self._problem.expected_runs().calibration_at_most if goes_on else 0

    @property
    @abstractmethod
    def _cells_left(self) -> float:
        """Cells that the search may ask for; infinite without a budget of simulations."""

    @property
    def _is_spent(self) -> bool:
        """True if the budget is used up."""
        return self._is_late or (self._limit is not None and self._cells_left < 1)

    @property
    def _is_late(self) -> bool:
        """True if the minutes of the budget are over."""
        budget = self._optimization.budget
        return budget is not None and budget.minutes is not None and self._minutes >= budget.minutes

    def record(self, completed: Sequence[Completed]) -> list[Work]:
        """See `Stage.record`."""
        self._begin(max((each.result.wall_milliseconds or each.result.milliseconds for each in completed), default=0.0))
        return super().record(completed)

    def _begin(self, milliseconds: float = 0.0) -> None:
        """Notes that the first run began this long ago, or that none is needed."""
        self._since = time.monotonic() - milliseconds / 1000 if self._since is None else self._since

    @property
    def _minutes(self) -> float:
        """Minutes of the search so far, or up to its end, without the time since its last stored result when it paused."""
        spent = None if self._search.ended_by is None else self._search.spent_minutes
        so_far = 0.0 if self._since is None else (time.monotonic() - self._since) / 60
        return so_far if spent is None else spent

    def _end_search(self, reason: SearchEnd) -> None:
        """Notes the end, which is stored with the next rows."""
        self._search = self._search.model_copy(update={"ended_by": reason, "spent_minutes": self._minutes})

    def _resume(self) -> list[Work]:
        """Resumes the rounds that have cells without an answer, or starts with the first.

        What the constructor read stays true: only the dispatcher changes it, and every transaction first checks that this process is
        still the one.
        """
        share_runs = self._problem.policy.mode != "off"
        with self._database.transaction() as connection:
            if self._next == 0:
                self._leader.remember_baseline(connection)
                return self._tracker.load(connection, share_runs=share_runs)
            seeds = {cell.seed for cell in results.pending(connection, self._campaign.sequence)}
            benches = [self._benches.of(seed) for seed in sorted(seeds)]
            work = self._tracker.load(connection, share_runs=share_runs, benches=benches)
            self._save(connection)
        for number in range(self._closed, self._next):
            self._round = Round(number, (), self._problem.policy)
            self._under_way.append(self._round)
        return work

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
            Generation(iteration=asked.number, carried_over=round_.unchanged * len(self._problem.scenarios)),
            population=round_.population.tolist(),
            changed=round_.changed.tolist(),
            optimizer_state=round_.state,
        )
        if asked.number == 0:
            events.add(connection, self._campaign.sequence, EventKind.STAGE, {"stage": self.name, "cells": self._at_most})
            for note in self._problem.notes:
                if note not in self._campaign.notes:  # the sensitivity stage has recorded those
                    events.add(connection, self._campaign.sequence, EventKind.NOTE, {"text": note})

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
            # runs under further seeds may have had rounds in between
            last, _ = evaluations.cells_from(connection, sequence, self.name, first)
            taken = max(first, last)
            if self._confirming is None:
                tried = results.sets_since(connection, sequence, self.name, first)
                last_look = self._search.last_look or []
                self._confirming, taken = Confirming(limit, believed.objective, tried, last_look), first
            tried = self._confirming.tried
            for number in range(taken, last + 1):
                self._answers.add(self._answers.read(connection, sequence, number))
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
        return Round(last + 1, [(self._problem.bench, wanted)], ReductionSpecification(mode="exact"))

    def _last_look(self, limit: int) -> list[int]:  # a hook
        """Returns the ids of dismissed sets that all answers together believe within reach of the best set."""
        del limit
        return []

    def _end_confirmation(self, connection: Connection, confirming: Confirming) -> None:
        """Stores the outcome of the confirmation, once; its simulations may contradict others."""
        best = self._ranking.best()
        dismissed = len(self._ranking.dismissed())
        if (confirming.tried or dismissed) and best is not None:
            last, scenarios = self._next - 1, self._problem.scenarios
            self._error_rate = check_reuse(connection, self._view, last, scenarios, self._error_rate)
            if self._confirmation is None or self._confirmation.tried < len(confirming.tried):
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
        asked, sequence = self._asked[number], self._campaign.sequence
        self._begin()
        with self._database.transaction() as connection:
            sets = self._ranking.sets
            self._answers.take_in(connection, sequence, [number])
            self._answers.settle(asked.population)
            objectives = self._answers.objectives(number)
            with self._view.reuse_time.counted():
                self._error_rate = check_reuse(connection, self._view, number, self._problem.scenarios, self._error_rate)
            is_better = self._leader.describe(connection) or self._answers.has_better_set()
            cells, carried_over = (
                evaluations.counts(connection, sequence, self.name, number),
                asked.unchanged * len(self._problem.scenarios),
            )
            cells = cells.model_copy(update={"carried_over": carried_over, "proposed": cells.requested + carried_over})
            figures = self._answers.figures(number, cells, objectives)
            self._search = self._progressed(figures, number, is_better=is_better, is_new=self._ranking.sets > sets)
            generations.finish(connection, sequence, figures, objectives.tolist())
            self._closed = number + 1
            self._save(connection)
            data = {"iterations": self._optimization.iterations, **figures.model_dump()}
            events.add(connection, sequence, EventKind.GENERATION, data)

    def _progressed(self, cells: GenerationCounts, number: int, *, is_better: bool, is_new: bool) -> SearchState:
        """Returns the state after a round. It counts simulations since the last better set, and generations since the last new set.

        A search without populations counts requested cells, not simulated ones: what it asks for must not depend on stored results.
        """
        search, budget = self._search, self._optimization.budget
        simulated = search.simulated + (cells.simulated + cells.failed if self.has_populations else cells.requested)
        better_at = simulated if is_better else search.better_at
        stale = search.stale + 1 if self.has_populations and budget is not None and not is_new else 0
        stood_still = budget is not None and budget.stagnation is not None and simulated - better_at >= budget.stagnation
        at = number + 1 if (stood_still or stale >= STALE) and search.stood_still_at is None else search.stood_still_at
        return search.model_copy(update={"simulated": simulated, "better_at": better_at, "stood_still_at": at, "stale": stale})

    def _snapshot(self, connection: Connection) -> StoredCampaign:
        counts = CellCounts(**self._tracker.counts)
        notes = [*self._problem.notes, *notes_on_lots(self._error_rate)]
        if counts.unrepeatable:
            advice = note_predictions(self._problem.specification, self._problem.bench.scale)  # holds for equal runs
            notes = [note for note in notes if note not in advice]
            notes.append(f"runs that differ from another one of the same cell: {counts.unrepeatable}; scores are samples")
            if not self._repeatable_no_more:
                events.add(connection, self._campaign.sequence, EventKind.NOTE, {"text": notes[-1]})
                self._repeatable_no_more = True
        notes += self._score_notes()
        repaired = self._search.repaired
        if repaired.collapses:
            notes.append(
                f"{repaired.proposed:,} proposals broke constraints and became {repaired.distinct:,} new sets: the search hardly moves;"
                " choose another optimizer, or loosen the constraints"
            )
        is_over = self._search.ended_by is not None
        reuse = 0.0 if self._problem.policy.mode == "off" else self._view.reuse_time.seconds
        if is_over and self._search.predictions_off is not None:
            notes.append(self._search.predictions_off)
        if is_over:
            notes += self._leader.notes()
        return replace(
            super()._snapshot(connection),
            iteration=self._next - 1 if self._next else None,
            search=self._search.model_copy(
                update={"reuse_seconds": reuse, "spent_minutes": self._minutes, "surest": self._leader.surest}
            ),
            progress=self._progress(counts.requested, counts.requested + counts.pending + (self._closing or 0)),
            error_rate=self._error_rate,
            best=self._leader.best,
            confirmation=self._confirmation,
            baseline=self._leader.baseline,
            notes=tuple(notes),
        )


class ComputedSearch(SearchStage):
    """A search that computes its rounds in a thread. Round n knows the answers of the rounds up to n - `window`, or more (`_is_empty`)."""

    window: ClassVar[int]

    def __init__(self, database: Database, campaign: StoredCampaign, problem: CalibrationProblem, view: View) -> None:
        super().__init__(database, campaign, problem, view)
        self._asker: Asker | None = None
        """The search; None until it is created or restored."""
        self._computation: Computation | None = None
        """The search's running computation; None if the next round needs none."""
        self._told, self._is_empty = max(0, self._next - self.window), False
        """Number of rounds whose answers the search knows, and whether it has nothing to ask for before it knows more."""
        self._replication = Replication(problem, self._answers, self._benches)
        self._closing = None

    def _awaited(self) -> Wait | None:
        """Waits until the search is restored, or has computed the next round, with more answers if it has nothing to ask for."""
        while (computed := self._computation) is not None:
            if not computed.is_done:
                return "computation"
            self._is_empty = computed.asks and computed.result()[1] is None and self._told < self._next
            if computed.asks and not self._is_empty:
                break
            (self._asker, _), self._computation = computed.result(), None
            if self._is_empty:
                self._go_on()
        return None

    def _compute(self, obtain: Callable[[], Asker]) -> None:
        """Begins to obtain the search, and to ask it for the next round if that may be asked for."""
        known, tells = None, self._is_empty or self._told <= self._next - self.window
        asks = not tells or self._closed > self._told
        if self._asker is not None and not asks:
            return
        if asks and tells:
            known = self._answers.for_search(self._told, self._asked.pop(self._told))
            self._told += 1
        if asks and (reason := self._end_before(self._next)) is not None:
            self._end_search(reason)
            return
        self._computation = Computation(obtain, known, asks=asks)

    def _go_on(self) -> None:
        """Begins to compute the next round, if it is time."""
        asker = self._asker
        if asker is not None and self._computation is None and self._search.ended_by is None:
            self._compute(lambda: asker)

    def _end_before(self, number: int) -> SearchEnd | None:
        """Returns why the search ends before a round; None if it goes on. Knows the rounds that the search knows, and the clock."""
        if self._optimization.iterations is not None and number >= self._optimization.iterations:
            return "iterations"
        if number and self._is_spent:
            return "budget"
        stood_still = self._search.stood_still_at
        return "stagnation" if stood_still is not None and stood_still <= self._told else None

    @property
    def _cells_left(self) -> float:
        return self._tracker.budget.left - ((self._limit or 0) - self._simulations)

    @property
    def _simulations(self) -> int:
        """Simulations of the budget that are the search's own; further ones tell its best sets apart."""
        varies = self._tracker.counts.get("unrepeatable", 0) > 0
        return self._problem.search_simulations(varies=varies) or 0

    def _propose(self) -> AskedRound | None:
        """Returns the computed round; None if there is none, or the search ends because it has nothing left to ask for."""
        if self._computation is None:
            return None
        (self._asker, asked), self._computation = self._computation.result(), None
        if asked is None:
            set_cells = len(self._problem.scenarios) * self._problem.least_replicates
            self._end_search("budget" if self._cells_left < set_cells else "stagnation")
            return None
        self._asked[self._next] = asked
        self._next += 1
        return asked

    def _cells(self, asked: AskedRound, individuals: Sequence[int]) -> list[tuple[Bench, list[RequestedCell]]]:
        """Returns the cells of some individuals of a round, with the benches of their seeds."""
        problem = self._problem
        sets = dict(zip(individuals, problem.space.parameter_sets(asked.population[individuals]), strict=True))
        purposes = {number: Purpose.START if each in problem.start_sets else Purpose.SEARCH for number, each in sets.items()}
        return self._benches.with_cells(
            [
                RequestedCell(individual, problem.scenarios[place], sets[individual], purpose=purposes[individual], seed=seed)
                for individual, place, seed in asked.cells
                if individual in sets
            ]
        )

    def _after_search(self) -> Round | None:
        """Returns the next set to confirm, or the next runs under further seeds that decide which set is the best, after the answers of
        the previous ones; None if all is decided, or the budget is used up."""
        asked, is_random = None, self._problem.bench.is_random
        if not is_random:
            asked = self._confirm()
        if asked is None and (is_random or self._tracker.counts.get("unrepeatable")):
            with self._database.transaction() as connection:
                asked = self._replication.ask(connection, self._campaign.sequence, self._next, self._search.room, self._tracker)
                self._closing = self._replication.left
                self._leader.describe(connection)
                self._save(connection)
        if asked is None and self._ranking.best() is None:
            failed = CellCounts(**self._tracker.counts).failed
            why = f"{failed:,} cells have none{self._causes()}" if failed else "the search ended before the first: give it more"
            raise NoResultError(f"no parameter set has a result in every scenario; {why}")
        return asked

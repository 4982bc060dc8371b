"""The calibration stage: asks the optimizer, plans the population, stores the answers and returns them to the optimizer, by iteration.

The optimizer computes in a thread beside the dispatcher's loop, so that a slow one keeps no other campaign waiting. A computation depends
only on stored rows and gives all that is stored of it, so that a process that dies repeats it with the same result.

On request, later rounds confirm the best set (`confirmation`). Their cells belong to the stage and continue its iteration numbers, but
belong to no generation.
"""

import threading
import weakref
from collections.abc import Callable
from concurrent.futures import Future, wait
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from sqlalchemy import Connection

from drivecal.analysis.confirmation import Confirming, front_outcome
from drivecal.analysis.goals import EQUAL
from drivecal.analysis.solutions import EvaluatedSet
from drivecal.analysis.verdicts import confirmation_verdict
from drivecal.campaigns.cells.inspection import check_reuse, form_lots_of_references, rejected_text
from drivecal.campaigns.cells.planning import View, sync_reference_keys
from drivecal.campaigns.cells.predicting import LotPlanner, skipped_text, slice_size
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.stages.population import PopulationAnswers
from drivecal.campaigns.stages.stage import Round, Stage
from drivecal.contracts.campaign import Baseline, Best, CellCounts, ErrorRate, GenerationCounts, Released
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import NoResultError
from drivecal.domain.evaluations import RequestedCell
from drivecal.domain.events import EventKind
from drivecal.domain.parameters import Indices, ParameterSet
from drivecal.execution.scheduling.in_flight import Work
from drivecal.optimizers.repair import checked_proposal
from drivecal.optimizers.replayed import abandon_when
from drivecal.plugins.ports import Floats, Optimizer, Proposal
from drivecal.reduction.assignment import Policy
from drivecal.reduction.narrowing import begun_area
from drivecal.storage import campaigns, events, generations, results
from drivecal.storage.campaigns import Snapshot, StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.generations import Figures, StoredGeneration
from drivecal.storage.references import parameter_sets

PATIENCE_SECONDS = 0.1
"""Time for which the first check of a computation waits: most proposals take milliseconds and need no further round of the dispatcher."""


@dataclass(frozen=True, slots=True)
class Computed:
    """An optimizer after its computation. `proposal` and `state`: of its next population, None if it was not asked for one."""

    optimizer: Optimizer
    proposal: Proposal | None = None
    state: dict[str, Any] | None = None


class Computation:
    """Creates or restores an optimizer, passes it answers and asks for its next population, in a thread of its own.

    When the last reference to this object is gone, nothing waits for the result: see `optimizers.replayed.stop_if_abandoned`.
    """

    def __init__(self, obtain: Callable[[], Optimizer], answers: tuple[Floats, Floats] | None, *, asks: bool) -> None:
        """`obtain` and what it refers to must not refer to this object. `answers`: to pass on first; see `Optimizer.tell`."""
        self._patience = PATIENCE_SECONDS
        self._outcome: Future[Computed] = Future()
        abandoned = threading.Event()
        weakref.finalize(self, abandoned.set)
        arguments = (self._outcome, abandoned, obtain, answers, asks)
        # A daemon: a process that ends waits for no optimizer.
        threading.Thread(target=_compute, args=arguments, name="optimizer", daemon=True).start()

    @property
    def is_done(self) -> bool:
        """Whether the result is there; only the first check waits for it, `PATIENCE_SECONDS` at most."""
        wait([self._outcome], self._patience)
        self._patience = 0.0
        return self._outcome.done()

    def result(self) -> Computed:
        """Returns the result; raises what the optimizer raised. Waits for it unless it `is_done`."""
        return self._outcome.result()


def _compute(
    outcome: Future[Computed],
    abandoned: threading.Event,
    obtain: Callable[[], Optimizer],
    answers: tuple[Floats, Floats] | None,
    asks: bool,  # noqa: FBT001  # a thread's arguments are positional
) -> None:
    abandon_when(abandoned.is_set)
    try:
        optimizer = obtain()
        if answers is not None:
            optimizer.tell(*answers)
        if asks:
            proposal = optimizer.ask()
            outcome.set_result(Computed(optimizer, proposal, optimizer.state()))
        else:
            outcome.set_result(Computed(optimizer))
    except BaseException as error:  # noqa: BLE001  # `result` raises it in the dispatcher's thread
        outcome.set_exception(error)


class Calibration(Stage):
    """The search of a campaign: a round is a generation of the optimizer, and after the last generation a set to confirm."""

    name = StageName.CALIBRATION
    uses_map = True

    def __init__(self, database: Database, campaign: StoredCampaign, problem: CalibrationProblem, view: View) -> None:
        if problem.optimization is None:
            raise ValueError("the campaign has no calibration stage")
        super().__init__(database, campaign, view)
        self._problem, self._optimization = problem, problem.optimization
        self._answers = PopulationAnswers(problem, problem.optimization.population)
        self._ranking = self._answers.ranking
        self._best, self._baseline = campaign.best, campaign.baseline
        self._error_rate: dict[str, ErrorRate] = dict(campaign.error_rate)
        self._area = problem.search_area(view.influence_map)
        if campaign.narrowed is not None:
            self._area = begun_area(self._area, campaign.narrowed)
        self._notes = problem.notes
        if problem.specification.reduction.narrow:
            self._notes = (*problem.notes, self._area.note())
        self._repeatable_no_more = campaign.cells.unrepeatable > 0
        self._before = GenerationCounts()
        self._iteration: int | None = None
        self._proposal: Proposal | None = None
        self._evaluated: Indices | None = None
        """The last population with all its answers."""
        self._optimizer: Optimizer | None = None
        self._optimizer_state: dict[str, Any] | None = None
        """State after the proposal, to be stored with it."""
        self._computation: Computation | None = None
        """The optimizer's running computation; None if the next round needs none."""
        self._last: StoredGeneration | None = None
        """The last generation of an earlier process."""
        self._batches: list[list[int]] = []
        """Individuals of the current generation that have not been requested."""
        self._planner: LotPlanner | None = None
        if self._policy().predicts:
            reduction, population = problem.specification.reduction, problem.optimization.population
            self._planner = LotPlanner(view, problem.space, reduction, problem.weights, population)
        self._released: dict[str, Released] = dict(campaign.released)
        self._confirming: Confirming | None = None
        """Withdrawn answers that the ranking knows of."""
        self._confirmation = campaign.confirmation

    @property
    def _at_most(self) -> int:
        return self._problem.expected_runs().calibration_at_most

    def _ask(self) -> Round | None:
        """The next batch of the generation, the next generation, or the next set to confirm."""
        if self._batches:
            return self._next_batch()
        if self._iteration is not None and self._iteration + 1 >= self._optimization.iterations:
            asked = self._confirm()
            if asked is None:
                self._refuse_nothing()
            return asked
        return self._propose()

    def _prepare(self) -> None:
        if self._planner is not None:
            self._planner.weigh()

    def _tell(self, asked: Round) -> None:
        if asked.number < self._optimization.iterations and not self._batches:
            self._close()

    def _refuse_nothing(self) -> None:
        if self._ranking.best() is None:
            failed = CellCounts(**self._tracker.counts).failed
            raise NoResultError(f"no parameter set has a result in every scenario; {failed:,} cells failed{self._causes()}")

    def _is_ready(self) -> bool:
        """Whether the optimizer has computed what the next round needs."""
        if not self._resumed and self._computation is None:
            self._begin()
        return self._computation is None or self._computation.is_done

    def _begin(self) -> None:
        """Reads the rows, and begins to restore the optimizer as it was after the last generation, or to create one."""
        sync_reference_keys(self._database, self._view)
        with self._database.read() as connection:
            self._last = last = generations.last(connection, self._campaign.sequence)
            if last is not None:
                finished = last.iteration + last.finished
                self._before = generations.sums(connection, self._campaign.sequence, finished)
                self._answers.take_in(connection, self._campaign.sequence, range(finished))
        constraints, area, optimization = self._problem.constraints, self._area, self._optimization
        if last is None:
            start = area.contract(self._problem.start_indices) if self._problem.start_sets else None
            self._computation = Computation(partial(optimization.begin, area, constraints, start), None, asks=True)
            return
        if last.optimizer_state is None:
            raise RuntimeError(f"generation {last.iteration} has no optimizer state")
        asks = last.finished and last.iteration + 1 < optimization.iterations
        answers = self._answers.for_optimizer() if asks else None
        self._computation = Computation(
            partial(optimization.restore, area, constraints, last.optimizer_state), answers, asks=asks
        )

    def _resume(self) -> list[Work]:
        """Resumes the last generation, or starts with the first, once the optimizer is restored.

        A replay may take long, so that no transaction is open meanwhile. What was read before stays true: only the dispatcher changes it,
        and every transaction first checks that this process is still the one.
        """
        last = self._last
        self._take_up(last)
        with self._database.transaction() as connection:
            if last is None:
                if self._problem.specification.reduction.narrow:
                    campaigns.set_narrowed(connection, self._campaign.sequence, self._area.narrowed())
                self._remember_baseline(connection)
                return []
            here = connection, self._campaign.sequence, self.name, last.iteration
            self._batches = [each for each in self._batches if not results.is_requested(*here, each[0] if each else None)]
            work = self._tracker.load(connection, share_runs=self._policy().mode != "off")
            self._save(connection)
        return work

    def _take_up(self, last: StoredGeneration | None) -> None:
        """Continues with the restored optimizer. Raises what restoring it raised."""
        if self._computation is None:
            raise RuntimeError("the optimizer has not begun")
        computed = self._computation.result()
        self._optimizer = computed.optimizer
        if computed.proposal is None:
            self._computation = None
        if last is None:
            return
        self._iteration = last.iteration
        if last.finished:
            self._evaluated = np.array(last.population, dtype=np.int64)
        else:
            self._proposal = Proposal(np.array(last.population, dtype=np.int64), np.array(last.changed, dtype=np.bool_))
            self._batches = self._split(last.iteration, self._proposal)
            self._round = Round(last.iteration, (), self._policy())

    def _propose(self) -> Round:
        if self._computation is None:
            raise RuntimeError("the stage has not started")
        computed, self._computation = self._computation.result(), None
        if computed.proposal is None:
            raise RuntimeError("the optimizer was not asked for a population")
        self._optimizer_state = computed.state
        count, n_values = self._optimization.population, self._area.n_values
        name = self._optimization.plugin.name
        self._proposal = checked_proposal(name, computed.proposal, count, n_values, self._evaluated)
        self._iteration = 0 if self._iteration is None else self._iteration + 1
        self._batches = self._split(self._iteration, self._proposal)
        carried_over = int((~self._proposal.changed).sum()) * len(self._problem.scenarios)
        return replace(self._next_batch(), carried_over=carried_over)

    def _split(self, iteration: int, proposal: Proposal) -> list[list[int]]:
        """Returns the individuals to request, in batches: the start population is learned from slice by slice if answers are predicted."""
        changed = [int(index) for index in np.flatnonzero(proposal.changed)]
        size = slice_size(self._optimization.population) if self._planner is not None and iteration == 0 else len(changed)
        return [changed[start : start + size] for start in range(0, len(changed), size)] if changed else [[]]

    def _next_batch(self) -> Round:
        if self._proposal is None or self._iteration is None:
            raise RuntimeError("the stage has not started")
        batch, problem = self._batches.pop(0), self._problem
        sets = problem.space.parameter_sets(self._area.expand(self._proposal.population[batch]))
        wanted = [
            RequestedCell(individual, scenario, parameters, is_given=self._iteration == 0 and individual in self._given)
            for individual, parameters in zip(batch, sets, strict=True)
            for scenario in problem.scenarios
        ]
        if self._planner is not None:
            with self._database.transaction() as connection:
                self._planner.learn(connection)
                self._answers.take_in(connection, self._campaign.sequence, [self._iteration])
            self._planner.predict(dict(zip(batch, sets, strict=True)))
        return Round(self._iteration, [(problem.bench, wanted)], self._policy())

    def _form_lots(self, connection: Connection, asked: Round, planned: list[RequestedCell]) -> list[RequestedCell]:
        if asked.number != self._iteration:
            return planned
        limit = self._problem.specification.reduction.max_error
        planned = form_lots_of_references(connection, self._view, planned, limit, self._error_rate)
        if self._planner is None:
            return planned
        best = self._ranking.surest()
        given = self._given if asked.number == 0 else ()
        reaches = None if self._problem.goals is None else self._ranking.reaches_front
        return self._planner.plan(connection, planned, None if best is None else best.objective, given, reaches)

    @property
    def _given(self) -> range:
        """Individuals of the start population that are the baseline or a given start set."""
        return range(len(self._problem.start_sets))

    def _policy(self) -> Policy:
        reduction = self._problem.specification.reduction
        return Policy(reduction.mode, reduction.audit, self._optimization.seed)

    def _store(self, connection: Connection, asked: Round) -> None:
        """Commits a generation with the optimizer's state beside its cells; a set to confirm belongs to no generation."""
        if self._optimizer_state is None or self._proposal is None or asked.number != self._iteration:
            return
        if generations.is_stored(connection, self._campaign.sequence, asked.number):  # with an earlier batch
            return
        generations.insert(
            connection,
            self._campaign.sequence,
            asked.number,
            figures=self._figures(),
            population=self._proposal.population.tolist(),
            changed=self._proposal.changed.tolist(),
            optimizer_state=self._optimizer_state,
        )
        if asked.number == 0:
            self._tell_beginning(connection)

    def _confirm(self) -> Round | None:
        """The best set in the scenarios with scores copied from references, after the previous answers; None when no set is left."""
        sequence, first = self._campaign.sequence, self._optimization.iterations
        limit, best = self._problem.specification.reduction.confirm, self._ranking.best()
        believed = self._ranking.doubtful() if best is None else best[0]  # every set may have a predicted score
        if limit == 0 or believed is None:
            return None
        with self._database.transaction() as connection:
            if self._confirming is None:
                tried = results.sets_since(connection, sequence, self.name, first)
                self._confirming, taken = Confirming(limit, believed.objective, tried), 0
            else:
                tried, taken = self._confirming.tried, len(self._confirming.tried) - 1
            for number in range(taken, len(tried)):
                self._ranking.add(self._answers.read(connection, sequence, first + number))
            if tried:
                self._describe_best(connection)
            chosen = self._confirming.choose(self._ranking)
            if chosen is None:
                self._end_confirmation(connection, self._confirming)
            else:
                parameters = parameter_sets.load(connection, [chosen.parameter_set])[chosen.parameter_set]
            self._save(connection)
        if chosen is None:
            return None
        wanted = [RequestedCell(0, scenario, parameters) for scenario in chosen.reused]
        tried.append(chosen.parameter_set)
        return Round(first + len(tried) - 1, [(self._problem.bench, wanted)], Policy("exact"))

    def _end_confirmation(self, connection: Connection, confirming: Confirming) -> None:
        """Stores the outcome of the confirmation, once; its simulations may contradict others."""
        best = self._ranking.best()
        if confirming.tried and best is not None:
            last, scenarios = self._optimization.iterations - 1, self._problem.scenarios
            self._error_rate = check_reuse(connection, self._view, last, scenarios, self._error_rate)
            if self._confirmation is None:
                goals = self._problem.goals
                is_front, untried = goals is not None and goals.is_vector, self._ranking.doubtful(confirming.tried)
                front = self._ranking.front() if is_front else []
                if is_front and (not best[0].reused or any(member.solution.reused for member in front)):
                    self._confirmation = front_outcome(front, confirming.tried, untried)
                else:
                    self._confirmation = confirming.outcome(best[0], untried)
                text = confirmation_verdict(self._confirmation).text
                events.add(connection, self._campaign.sequence, EventKind.NOTE, {"text": text})
                if not is_front and confirming.is_changed(best[0]):
                    self._tell_best(connection, best[0])

    def _close(self) -> None:
        """Closes an iteration: every cell has its answer."""
        if self._optimizer is None or self._iteration is None:
            raise RuntimeError("the stage has not started")
        with self._database.transaction() as connection:
            self._answers.take_in(connection, self._campaign.sequence, [self._iteration])
            objectives = self._answers.objectives()
            self._error_rate = check_reuse(connection, self._view, self._iteration, self._problem.scenarios, self._error_rate)
            if self._planner is not None:
                self._released = self._planner.released(connection, self._iteration)
            self._describe_best(connection)
            figures = self._figures(objectives)
            generations.finish(connection, self._campaign.sequence, self._iteration, figures, objectives.tolist())
            self._save(connection)
            data = {"iteration": self._iteration, "iterations": self._optimization.iterations, **figures.flat}
            events.add(connection, self._campaign.sequence, EventKind.GENERATION, data)
        self._before = CellCounts(**self._tracker.counts)
        self._evaluated = None if self._proposal is None else self._proposal.population
        self._proposal = None
        if self._iteration + 1 < self._optimization.iterations:
            optimizer = self._optimizer
            self._computation = Computation(lambda: optimizer, self._answers.for_optimizer(), asks=True)

    def _describe_best(self, connection: Connection) -> None:
        best = self._ranking.best()
        if best is not None:
            solution, alternatives = best
            parameters = parameter_sets.load(connection, [solution.parameter_set])[solution.parameter_set]
            before = self._best
            self._best = Best(
                objective=solution.objective,
                parameters=parameters.floats,
                scores=dict(solution.scores),
                alternatives=alternatives,
                violation=solution.shares_violated,
            )
            gain = 0.0 if before is None else solution.sign * (self._best.objective - before.objective)
            goals = self._problem.goals  # the first set that keeps all constraints may be worse than the last that does not
            if before is None or gain > EQUAL or (goals is not None and goals.bounds and gain < -EQUAL):
                self._tell_best(connection, solution)
        unknown = self._baseline is None or self._baseline.objective is None
        self._remember_baseline(connection)
        if unknown and self._baseline is not None and self._baseline.objective is not None:
            events.add(connection, self._campaign.sequence, EventKind.BASELINE, self._baseline.model_dump())

    def _tell_best(self, connection: Connection, solution: EvaluatedSet) -> None:
        best = {} if self._best is None else self._best.model_dump()
        events.add(connection, self._campaign.sequence, EventKind.BEST, best | {"iteration": solution.iteration})

    def _remember_baseline(self, connection: Connection) -> None:
        baseline: ParameterSet | None = self._problem.baseline
        if baseline is None:
            return
        (number,) = parameter_sets.ensure(connection, [baseline])
        solution: EvaluatedSet | None = self._ranking.get(number)
        none_yet: dict[str, float | None] = dict.fromkeys(self._problem.scenarios)
        self._baseline = Baseline(
            objective=None if solution is None else solution.objective,
            parameters=baseline.floats,
            scores=none_yet if solution is None else dict(solution.scores),
            violation=0.0 if solution is None else solution.shares_violated,
        )

    def _figures(self, objectives: np.ndarray[tuple[int], np.dtype[np.float64]] | None = None) -> Figures:
        now = self._tracker.counts
        counted = {name: now.get(name, 0) - getattr(self._before, name) for name in GenerationCounts.model_fields}
        cells = GenerationCounts(**counted)
        if objectives is None:
            return Figures(cells)
        best = self._ranking.best()
        known = objectives[~np.isnan(objectives)]
        return Figures(
            cells,
            best=None if best is None else best[0].objective,
            rating=None if best is None else best[0].rating,
            mean=float(known.mean()) if known.size else None,
            minimum=self._answers.worst(objectives),
            alternatives=0 if best is None else best[1],
        )

    def _tell_beginning(self, connection: Connection) -> None:
        events.add(connection, self._campaign.sequence, EventKind.STAGE, {"stage": self.name, "cells": self._at_most})
        for note in self._notes:
            if note not in self._campaign.notes:  # the sensitivity stage has told those
                events.add(connection, self._campaign.sequence, EventKind.NOTE, {"text": note})

    def _snapshot(self, connection: Connection) -> Snapshot:
        counts = CellCounts(**self._tracker.counts)
        notes = list(self._notes)
        if (rejected := rejected_text(self._error_rate)) is not None:
            notes.append(rejected)
        if counts.unrepeatable:
            notes.append(f"{counts.unrepeatable} simulations differ from another run of the same cell: scores are samples")
            if not self._repeatable_no_more:
                events.add(connection, self._campaign.sequence, EventKind.NOTE, {"text": notes[-1]})
                self._repeatable_no_more = True
        notes += self._score_notes()
        if (skipped := skipped_text(self._released)) is not None and self._iteration == self._optimization.iterations - 1:
            notes.append(skipped)
        if self._best is not None and self._best.violation > 0 and self._iteration == self._optimization.iterations - 1:
            notes.append(f"no set keeps all constraints on results: the best set breaks them by {self._best.violation:.1%}")
        return replace(
            super()._snapshot(connection),
            iteration=self._iteration,
            progress=self._progress(counts.requested, counts.requested + counts.pending),
            error_rate=self._error_rate,
            released=self._released,
            best=self._best,
            confirmation=self._confirmation,
            baseline=self._baseline,
            notes=notes,
        )

"""The task of a search by the cell: the space, the aim, and the answers that are stored before the campaign begins."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from sqlalchemy import Connection

from drivecal.analysis.aims import JudgedGoals, WeightedScore
from drivecal.analysis.goals import SCORE
from drivecal.analysis.replicates import choosing
from drivecal.campaigns.cells import earlier
from drivecal.campaigns.cells.earlier import place_in
from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.resolve.optimizer import Optimization
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.stages.answers import CellAnswers
from drivecal.campaigns.stages.asking import WINDOW, AskedRound, PopulationAsker
from drivecal.contracts.campaign import GenerationCounts, SearchState
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import CellScore, RequestedCell
from drivecal.domain.parameters import Indices
from drivecal.optimizers.population import start_population
from drivecal.plugins.ports import Floats
from drivecal.plugins.search import Aim, AskedCell, CellAnswer, SearchTask
from drivecal.storage import campaigns, evaluations, generations
from drivecal.storage.engine.database import Database
from drivecal.storage.generations import StoredGeneration
from drivecal.storage.references import runs

MOST_BEST = 3
"""Best stored sets by each objective that a search begins with."""
MOST_KNOWN = 2_000
"""Newest stored runs of each scenario from which a search begins."""

STALE = 50
"""Generations without a new set after which a search with a budget ends: its space is exhausted, or its population stands still."""


def progressed(
    search: SearchState, cells: GenerationCounts, chosen: Optimization, number: int, *, is_better: bool, is_new: bool
) -> SearchState:
    """Returns the state after a round. It counts simulations since the last better set, and generations since the last new set.

    A search by the cell counts requested cells, not simulated ones: what it asks for must not depend on stored results.
    """
    budget, by_cell = chosen.budget, chosen.by_cell is not None
    simulated = search.simulated + (cells.requested if by_cell else cells.simulated + cells.failed)
    better_at = simulated if is_better else search.better_at
    stood_still = budget is not None and budget.stagnation is not None and simulated - better_at >= budget.stagnation
    stale = 0 if is_new or budget is None or by_cell else search.stale + 1
    stood_still = stood_still or stale >= STALE
    at = number + 1 if stood_still and search.stood_still_at is None else search.stood_still_at
    return search.model_copy(update={"simulated": simulated, "better_at": better_at, "stood_still_at": at, "stale": stale})


def search_task(database: Database, view: View, problem: CalibrationProblem, answers: CellAnswers) -> SearchTask:
    """Returns the task of a campaign's search. It depends on what was stored when the campaign began, and on nothing later."""
    chosen = problem.optimization
    if chosen is None:
        raise ValueError("the campaign has no search")
    space, constraints = problem.space, problem.search_constraints
    region = constraints.whole_region if constraints else None

    def repair(rows: Indices) -> Indices:
        return rows if region is None else region.repair(rows)

    def sample(count: int, generator: np.random.Generator) -> Indices:
        if region is None:
            return start_population("lhs", count, space.n_values, generator, None)
        return region.sample(count, generator)

    limit = problem.search_simulations()
    is_cut_off = problem.specification.reduction.mode == "off"
    aim, variants = answers.aim, answers.aims_of_variants
    known = [] if is_cut_off else _known(database, view, problem, aim)
    start, changes = problem.start_indices, problem.goals.changes
    best = [indices for indices in best_known((aim, *variants), known) if list(indices) not in start.tolist()]
    first = {*best, *map(tuple, start.tolist())}  # asked all the same, so that the campaign ranks them
    return SearchTask(
        n_values=space.n_values,
        kinds=space.kinds,
        aim=aim,
        feasible=constraints.feasible,
        repair=repair,
        sample=sample,
        start=np.concatenate([start, np.array(best, dtype=np.int64).reshape(len(best), len(space.n_values))]),
        known=[answer for answer in known if answer.cell.indices not in first],
        cells=None if limit is None else most_cells(limit, problem.bench.repeated_share) // problem.least_replicates,
        window=WINDOW,
        random=problem.bench.is_random,
        replicates=choosing(problem.specification.replicates.most) // problem.least_replicates
        if problem.bench.is_random
        else 1,
        given=(lambda rows: aim.given(constraints.entries(rows))) if changes and isinstance(aim, JudgedGoals) else None,
        references=np.unique([each.row(space) for each in changes.values()], axis=0) if changes else None,
        variants=variants,
    )


def population_asker(problem: CalibrationProblem, last: StoredGeneration | None, populations: Sequence[Any]) -> PopulationAsker:
    """Returns the search by populations as it was after the `last` generation; `populations`: all so far, with constraints only."""
    chosen = problem.optimization
    if chosen is None:
        raise ValueError("the campaign has no search")
    if last is None:
        optimizer = chosen.begin(problem.search_constraints, problem.start_indices if problem.start_sets else None)
    elif last.optimizer_state is None:
        raise RuntimeError(f"generation {last.iteration} has no optimizer state")
    else:
        optimizer = chosen.restore(problem.search_constraints, last.optimizer_state)
        populations = populations or [last.population]
    shape = chosen.population, problem.space.n_values
    return PopulationAsker(optimizer, chosen.plugin.name, shape, len(problem.scenarios), populations, problem.least_replicates)


def asked_rounds(connection: Connection, campaign: int, scenarios: Sequence[str]) -> list[AskedRound]:
    """Returns all rounds of a search by the cell."""
    places, cells = {name: place for place, name in enumerate(scenarios)}, dict[int, list[tuple[int, int, int]]]()
    for iteration, individual, scenario, seed in evaluations.places(connection, campaign, StageName.CALIBRATION):
        cells.setdefault(iteration, []).append((individual, places[scenario], seed))
    populations = [np.array(each, dtype=np.int64) for each in generations.populations(connection, campaign)]
    return [
        AskedRound(rows, np.ones(len(rows), dtype=np.bool_), cells.get(number, []), {})
        for number, rows in enumerate(populations)
    ]


def most_cells(runs: int, repeated_share: float) -> int:
    """Returns the cells that a search may ask for in a budget of runs: `repeated_share` of the simulated cells run twice."""
    return runs - math.ceil(runs * repeated_share / (1.0 + repeated_share))


def affordable(
    planned: Sequence[RequestedCell], room: float, seeds: Sequence[int], kept: set[int], *, by_cell: bool
) -> list[RequestedCell]:
    """Returns the first planned cells that fit into the room, without parts of individuals unless the search is `by_cell`.

    By the cell, every cell counts, else every cell without a stored answer: workers simulate rejected lots, too.

    Args:
        planned: cells under one of the seeds of a round.
        room: number of runs that are left.
        seeds: the seeds of the round, in the order of planning.
        kept: individuals that fitted under the last seed, which this call updates: an individual runs under all seeds or none.
        by_cell: whether the search asks by the cell.
    """
    if by_cell:
        return list(planned[: int(min(max(0, room), len(planned)))])
    place, within = seeds.index(planned[0].seed) if planned else 0, list(planned)
    if place:
        within = [cell for cell in planned if cell.individual in kept]
    room /= len(seeds) - place
    for number, cell in enumerate(within):
        room -= not cell.answered_at_once
        if room < 0:
            within = [each for each in within[:number] if each.individual != cell.individual]
            break
    kept.clear()
    kept.update(cell.individual for cell in within)
    return within


def best_known(aims: Sequence[Aim], known: Sequence[CellAnswer]) -> list[tuple[int, ...]]:
    """Returns the best stored sets, which a search asks for first: the table answers them, so that the campaign ranks them.

    Args:
        aims: the campaign's aim, and the aims of its variants.
        known: stored answers.

    Returns:
        grid indices of the MOST_BEST best sets by each objective; constraints on results come first.
    """
    sets, aim = dict[tuple[int, ...], Floats](), aims[0]
    for answer in known:
        cells = sets.setdefault(answer.cell.indices, np.full((aim.scenarios, aim.values), np.nan))
        cells[answer.cell.scenario] = answer.values
    listed, best = list(sets), dict[tuple[int, ...], None]()
    for each in aims if listed else ():
        objectives, violations = each.judge(np.array(list(sets.values())))
        whole = np.flatnonzero(np.isfinite(violations) & np.isfinite(objectives).all(axis=1))
        for objective in objectives[whole].T:
            order = np.lexsort((-objective, violations[whole]))[:MOST_BEST]
            best |= dict.fromkeys(listed[place] for place in whole[order].tolist())
    return list(best)


def _known(database: Database, view: View, problem: CalibrationProblem, aim: WeightedScore | JudgedGoals) -> list[CellAnswer]:
    """Returns the stored answers of sets in the space, in the order of references."""
    answers = []
    with database.transaction() as connection:
        watermark = campaigns.first_watermark(connection, view.campaign)  # the same again is the same
        for place, scenario in enumerate(problem.scenarios):
            stored = earlier.rated(connection, view.bench, view.earlier, scenario, watermark, MOST_KNOWN)
            measured = {} if problem.goals.valued is None else runs.values_of(connection, [run.evaluation for run in stored])
            for run in stored:
                indices = place_in(problem.space, run.parameters)
                if indices is None:
                    continue
                values = {SCORE: run.score}
                if measured:
                    values |= problem.goals.values(*measured[run.evaluation], run.parameters)
                cell = CellScore(0, scenario, run.score, run.rating, own=True, iteration=0, individual=0, values=values)
                failed = run.score == view.bench.scale.failed
                answers.append(CellAnswer(AskedCell(indices, place), aim.of(cell), failed=failed))
    return answers

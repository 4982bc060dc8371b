"""A search by the cell: a round is some cells of some sets, and several rounds are under way.

Its task is the space, the aim, and the answers that are stored before the campaign begins.
"""

import math
from collections.abc import Iterator, Sequence
from functools import cache, partial
from itertools import groupby

import numpy as np
from sqlalchemy import Connection

from drivecal.analysis.aims import JudgedGoals, WeightedScore
from drivecal.analysis.front import non_dominated
from drivecal.analysis.goals import SCORE, over_seeds
from drivecal.analysis.replicates import assess, choosing
from drivecal.campaigns.cells import earlier
from drivecal.campaigns.cells.earlier import place_in
from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.resolve.bench import Bench
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.stages.answers import CellAnswers, asked_rounds
from drivecal.campaigns.stages.asking import WINDOW, CellAsker, cells_of
from drivecal.campaigns.stages.replication import SeededBenches
from drivecal.campaigns.stages.search import ComputedSearch
from drivecal.campaigns.stages.stage import Round
from drivecal.domain.evaluations import CellScore, RequestedCell
from drivecal.domain.parameters import Indices, ParameterSet
from drivecal.optimizers.population import start_population
from drivecal.plugins.search import Aim, AskedCell, CellAnswer, SearchPlugin, SearchTask
from drivecal.storage import campaigns, generations
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.generations import StoredGeneration
from drivecal.storage.references import runs

MOST_BEST = 3
"""Best stored sets by each objective that a search begins with."""
MOST_FRONT = 12
"""Sets of the stored front that it begins with as well, from one end to the other."""
SURE = 0.95
"""Confidence of what such a set reaches at least if its runs are random."""
MOST_KNOWN, MOST_READ = 2_000, 10_000
"""Newest stored runs of each scenario that a search knows when it begins, and among which the best stored sets are looked for."""


class CellSearch(ComputedSearch):
    """A search whose plug-in asks for cells."""

    window = WINDOW
    asks_ahead = True
    kind_of_answers = CellAnswers
    _answers: CellAnswers

    def __init__(self, database: Database, campaign: StoredCampaign, problem: CalibrationProblem, view: View) -> None:
        self._within = problem.search_simulations() or 0
        super().__init__(database, campaign, problem, view)
        if self._limit is not None:
            self._tracker.limit_cells(_most_cells(self._within, problem))
        with database.read() as connection:
            last = generations.last(connection, campaign.sequence)
            self._answers.take_in(connection, campaign.sequence, range(self._closed))
            rounds = asked_rounds(connection, campaign.sequence, problem.scenarios)
        self._told = 0 if last is None else (last.optimizer_state or {}).get("told", 0)
        self._asked = {number: asked for number, asked in enumerate(rounds) if number >= self._told}
        if self._search.ended_by is None:
            answers = [self._answers.for_search(number, rounds[number])[0] for number in range(self._told)]
            asked = [cells_of(asked, problem.least_replicates) for asked in rounds]
            self._compute(partial(self._restored, asked, answers, last))

    def _restored(
        self, rounds: Sequence[Sequence[AskedCell]], answers: Sequence[Sequence[CellAnswer]], last: StoredGeneration | None
    ) -> CellAsker:
        """Returns the search as it was after the `last` round; a new one before the first."""
        plugin, settings = self._optimization.plugin, self._optimization.settings
        if not isinstance(plugin, SearchPlugin):
            raise TypeError(f"{plugin.name} does not search by the cell")
        task = _search_task(self._database, self._view, self._problem, self._answers, self._benches)
        state = {} if last is None else (last.optimizer_state or {}).get("search", {})
        search = plugin.begin(settings, task) if last is None else plugin.resume(settings, task, rounds, answers, state)
        return CellAsker(search, self._search.room, self._problem.least_replicates)

    def _may_ask(self) -> bool:
        return not self._under_way or self._computation is not None

    def _ask(self) -> Round | None:
        """Returns the next round of the search, or the next one after it."""
        asked = self._propose()
        if asked is None:
            return None if self._under_way else self._after_search()
        asked.state["told"] = self._told
        self._tracker.note_discarded(asked.state.get("discarded", 0))
        result = Round(
            self._next - 1, self._cells(asked, range(len(asked.population))), self._problem.policy, before=self._told
        )
        self._go_on()
        return result

    def _tell(self, asked: Round) -> None:
        if asked.number < self._next:
            self._close(asked.number)
            self._go_on()

    @property
    def _cells_left(self) -> float:
        left, budget = super()._cells_left, self._tracker.budget
        return left if math.isinf(left) else min(left, budget.kept - (self._within - self._simulations))

    def _affordable(self, connection: Connection, asked: Round, planned: list[RequestedCell]) -> list[RequestedCell]:
        """Returns the first cells for which the budget suffices: each counts, whatever is stored."""
        del connection
        if asked.number >= self._next:
            return planned
        room = int(min(max(0, self._cells_left), len(planned)))
        if room < len(planned):
            self._end_search("budget")
        return planned[:room]


def _search_task(
    database: Database, view: View, problem: CalibrationProblem, answers: CellAnswers, benches: SeededBenches
) -> SearchTask:
    """Returns the task of a campaign's search. It depends on what was stored when the campaign began, and on nothing later."""
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
    most = problem.specification.replicates.most
    replicates = max(1, choosing(most) // problem.least_replicates) if problem.bench.is_random else 1
    known = [] if is_cut_off else _known(database, view, problem, aim, benches, replicates)
    if constraints and known:  # they may be newer than what is stored
        allowed = constraints.feasible(np.array([answer.cell.indices for answer in known]))
        known = [answer for answer, is_allowed in zip(known, allowed, strict=True) if is_allowed]
    start, changes = problem.start_indices, problem.goals.changes
    best = [indices for indices in _best_known((aim, *variants), known) if list(indices) not in start.tolist()]
    first = {*best, *map(tuple, start.tolist())}  # asked all the same, so that the campaign ranks them
    return SearchTask(
        n_values=space.n_values,
        kinds=space.kinds,
        aim=aim,
        feasible=constraints.feasible,
        repair=repair,
        sample=sample,
        start=np.concatenate([start, np.array(best, dtype=np.int64).reshape(len(best), len(space.n_values))]),
        known=[each for each in _newest(known) if each.cell.indices not in first or each.cell.replicate > 1],
        cells=None if limit is None else _most_cells(limit, problem) // problem.least_replicates,
        window=WINDOW,
        random=problem.bench.is_random,
        replicates=replicates,
        given=(lambda rows: aim.given(constraints.entries(rows))) if changes and isinstance(aim, JudgedGoals) else None,
        references=np.unique([each.row(space) for each in changes.values()], axis=0) if changes else None,
        variants=variants,
    )


def _most_cells(runs: int, problem: CalibrationProblem) -> int:
    """Returns the cells that a search may ask for in a budget of runs: some run twice, unless that would cost it a set."""
    share, size = problem.bench.repeated_share, len(problem.scenarios) * problem.least_replicates
    most = runs - math.ceil(runs * share / (1.0 + share))
    whole = -(-most // size) * size
    return whole if whole <= runs else most


def _newest(known: Sequence[CellAnswer]) -> list[CellAnswer]:
    by_scenario = groupby(known, lambda answer: (answer.cell.replicate, answer.cell.scenario))
    return [answer for _, answers in by_scenario for answer in list(answers)[-MOST_KNOWN:]]


def _best_known(aims: Sequence[Aim], known: Sequence[CellAnswer]) -> list[tuple[int, ...]]:
    """Returns the best stored sets, which a search asks for first: the table answers them, so that the campaign ranks them.

    Args:
        aims: the campaign's aim, and the aims of its variants.
        known: stored answers.

    Returns:
        grid indices of the MOST_BEST best sets by each objective, of random runs by what they reach at least; constraints on results come
        first.
    """
    aim, listed = aims[0], {answer.cell.indices: None for answer in known}
    places = dict(zip(listed, range(len(listed)), strict=True))
    replicates = max((answer.cell.replicate for answer in known), default=0)
    values = np.full((len(listed), replicates, aim.scenarios, aim.values), np.nan)
    for answer in known:
        values[places[answer.cell.indices], answer.cell.replicate - 1, answer.cell.scenario] = answer.values
    # a scenario that no set has changes no order: each counts its own mean there
    means = np.nansum(values, axis=2) / np.maximum(1, (~np.isnan(values)).sum(axis=2))
    values[:, :, np.isnan(values).all(axis=(0, 1, 3))] = means[:, :, np.newaxis]
    best, sets = dict[tuple[int, ...], None](), list(listed)
    for each in aims if listed else ():
        objectives, violations = each.judge(values.reshape(-1, *values.shape[2:]))
        violations = np.where(np.isfinite(objectives).all(axis=1), violations, np.nan).reshape(values.shape[:2])
        whole = np.flatnonzero(np.isfinite(violations).any(axis=1))
        for samples in objectives.T.reshape(-1, *violations.shape) if len(whole) else ():
            standing = assess(np.where(np.isnan(violations), np.nan, samples)[whole])
            order = np.lexsort((-standing.bounds(SURE), np.nanmean(violations[whole], axis=1)))[:MOST_BEST]
            best |= dict.fromkeys(sets[place] for place in whole[order].tolist())
        if objectives.shape[1] > 1 and len(whole):  # what it knows of the front fills no gap in its own
            points = np.nanmean(objectives.reshape(*violations.shape, -1)[whole], axis=1)
            mask = non_dominated(points, np.nanmean(violations[whole], axis=1))
            front = sorted(np.flatnonzero(mask).tolist(), key=lambda place: points[place, 0])
            evenly = np.linspace(0, len(front) - 1, min(len(front), MOST_FRONT)).round().astype(np.int64)
            best |= dict.fromkeys(sets[whole[front[at]]] for at in evenly.tolist())
    return list(best)


def _known(
    database: Database,
    view: View,
    problem: CalibrationProblem,
    aim: WeightedScore | JudgedGoals,
    benches: SeededBenches,
    replicates: int,
) -> list[CellAnswer]:
    """Returns the stored answers of sets in the space, by replicate, scenario, and in the order of references. An answer is the mean over
    the seeds of a replicate, if all are stored."""
    answers, least, placed = list[CellAnswer](), problem.least_replicates, cache(partial(place_in, problem.space))
    with database.read() as connection:
        watermark = campaigns.first_watermark(connection, view.campaign)  # the same again is the same
        for replicate in range(1, replicates + 1):
            before, seeds = len(answers), range(1 + (replicate - 1) * least, 1 + replicate * least)
            for place, scenario in enumerate(problem.scenarios):
                cells = dict[tuple[int, ...], dict[int, CellScore]]()
                for seed in seeds:
                    for parameters, cell in _stored(connection, view, problem, benches.of(seed), scenario, watermark):
                        if (indices := placed(parameters)) is not None:
                            cells.setdefault(indices, {})[seed] = cell
                for indices, by_seed in cells.items():
                    if len(known := list(by_seed.values())) == least:
                        failed, asked = all(map(aim.is_failure, known)), AskedCell(indices, place, replicate)
                        answers.append(CellAnswer(asked, aim.of(over_seeds(known)), failed=failed))
            if len(answers) == before:  # no search has come so far
                break
    return answers


def _stored(
    connection: Connection, view: View, problem: CalibrationProblem, bench: Bench, scenario: str, watermark: int
) -> Iterator[tuple[ParameterSet, CellScore]]:
    """Yields the sets of a bench's stored runs in a scenario, and their scores."""
    stored = earlier.rated(connection, bench, view.earlier, scenario, watermark, MOST_READ)
    measured = {} if problem.goals.valued is None else runs.values_of(connection, [run.id for run in stored])
    for run in stored:
        values = {SCORE: run.score}
        if measured:
            values |= problem.goals.values(*measured[run.id], run.parameters)
        failed = bool(measured) and measured[run.id][1] is not None
        score = CellScore(0, scenario, run.score, run.rating, own=True, iteration=0, individual=0, failed=failed, values=values)
        yield run.parameters, score

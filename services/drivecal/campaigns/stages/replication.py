"""Runs of random simulators: the benches of seeds, and the runs after a search that decide which set is the best."""

from collections.abc import Sequence
from functools import cache
from itertools import groupby

import numpy as np
from sqlalchemy import Connection

from drivecal.analysis import replicates
from drivecal.analysis.solutions import Ranking
from drivecal.campaigns.cells.cell_tracker import CellTracker
from drivecal.campaigns.resolve.bench import Bench
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.stages.answers import SearchAnswers
from drivecal.campaigns.stages.stage import Round, exact_policy
from drivecal.contracts.specification import ReplicatesSpecification
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Purpose, RequestedCell
from drivecal.storage import evaluations
from drivecal.storage.references import parameter_sets


class SeededBenches:
    """The benches of a problem by seed, each made once."""

    def __init__(self, bench: Bench) -> None:
        self.of = cache(bench.seeded)
        """The bench of a seed."""

    def with_cells(self, wanted: Sequence[RequestedCell]) -> list[tuple[Bench, list[RequestedCell]]]:
        """Returns cells with the benches of their seeds, in the order of the seeds."""
        by_seed = groupby(sorted(wanted, key=lambda cell: cell.seed), lambda cell: cell.seed)
        return [(self.of(seed), list(cells)) for seed, cells in by_seed] or [(self.of(1), [])]


class Replication:
    """The rounds after a search under further seeds. They belong to no generation, and each depends on the rows of those before."""

    def __init__(self, problem: CalibrationProblem, answers: SearchAnswers, benches: SeededBenches) -> None:
        self._problem, self._answers, self._benches = problem, answers, benches
        self._taken = -1
        """The last round whose answers are taken in."""
        self.left = 0
        """Cells that it may still ask for after the last round."""

    def ask(self, connection: Connection, campaign: int, first: int, room: int, tracker: CellTracker) -> Round | None:
        """Takes the answers of the rounds before, and returns the next one; None if the best set is known, or the budget is used up.

        Args:
            connection: where to read.
            campaign: number of the campaign.
            first: the first round after the search.
            room: cells of a round, about.
            tracker: the cells of the stage.
        """
        last, cells_after = evaluations.cells_from(connection, campaign, StageName.CALIBRATION, first)
        for number in range(max(first, self._taken + 1), last + 1):
            self._answers.add(self._answers.read(connection, campaign, number))
        self._taken = last
        left = max(0, self._left(tracker, cells_after))
        most = self._problem.specification.replicates.most
        choosing = replicates.choosing(most)
        rankings = (self._answers.ranking, *self._answers.variants.values())
        compared = self._runs_of_baseline(connection)
        reports = [
            0,
            *(_missing_reports(each, most) * len(each.scenarios) for each in rankings[1:]),
            len(compared) * len(rankings[0].scenarios),
        ]
        for place, ranking in enumerate(rankings):
            scenarios = [name for name in self._problem.scenarios if name in ranking.scenarios]
            later = sum(reports[place + 1 :])
            affordable = max(0, left - later) // len(scenarios)
            chosen = next_runs(ranking, self._problem.specification.replicates, room, affordable)
            if chosen:
                break
        else:
            scenarios, later = list(self._problem.scenarios), 0
            chosen = compared[: left // len(scenarios)]
            left = len(chosen) * len(scenarios)
        sets = parameter_sets.load(connection, list({number for number, _ in chosen}))
        numbers = list(dict.fromkeys(number for number, _ in chosen))
        purposes = Purpose.CHOICE, Purpose.REPORT
        cells = [
            RequestedCell(numbers.index(number), scenario, sets[number], purpose=purposes[seed > choosing], seed=seed)
            for number, seed in chosen
            for scenario in scenarios
        ]
        # choosing mostly takes all that is left, reports are few
        self.left = 0 if not cells else later if cells[0].purpose is Purpose.REPORT else left - len(cells)
        return Round(last + 1, self._benches.with_cells(cells), exact_policy(self._problem)) if cells else None

    def _runs_of_baseline(self, connection: Connection) -> list[tuple[int, int]]:
        """Returns the baseline, by its id, with each seed that it is still to run under, to be compared with the best set: as many again
        while runs do not tell which is better."""
        ranking, baseline = self._answers.ranking, self._problem.baseline
        best, kept = ranking.best(), None if baseline is None else ranking.statistics()
        if baseline is None or best is None or kept is None or (kept[1].is_known and not kept[1].is_random):
            return []
        number = parameter_sets.ids(connection, [baseline.key]).get(baseline.key)
        if number is None or number == best[0].parameter_set or ranking.get(number) is None:
            return []
        done, seeds = ranking.seeds(number), self._problem.baseline_seeds
        missing = [seed for seed in seeds if seed not in done]
        if seeds and not missing and ranking.gain_over(number, random=True)[1]:
            shared = [seed for seed in sorted(ranking.seeds(best[0].parameter_set) - done) if seed >= seeds[0]]
            missing = shared[: sum(seed >= seeds[0] for seed in done)]
        return [(number, seed) for seed in missing]

    def _left(self, tracker: CellTracker, after: int) -> int:
        """Returns how many simulations the budget has left, or are adequate for what the search has asked without one. Answers from the
        table count as in the search, so that the same campaign again asks for the same cells."""
        chosen, requested = self._problem.optimization, tracker.counts.get("requested", 0)
        if chosen is None or chosen.budget is None or chosen.budget.simulations is None:
            most, shown = self._problem.specification.replicates.most, self._problem.fewest_seeds
            searched, of_set = requested - after, len(self._problem.scenarios) * self._problem.least_replicates
            if chosen is None or chosen.has_populations:  # which ask for equal sets again and again
                searched = min(searched, self._answers.ranking.sets * of_set)
            fewest = replicates.fewest(len(self._problem.scenarios), most, shown, self._problem.scenarios_of_variants)
            kept = max(fewest, int(searched * replicates.KEPT / (1 - replicates.KEPT)))
            return kept + len(self._problem.baseline_seeds) * len(self._problem.scenarios) - after
        left = int(tracker.budget.left)
        return left if chosen.has_populations else min(left, chosen.budget.simulations - requested)


def _missing_reports(ranking: Ranking, most: int) -> int:
    """Returns how many of the fewest runs that report the best set were not requested yet."""
    best, choosing = ranking.best(), replicates.choosing(most)
    reported = 0 if best is None else sum(seed > choosing for seed in ranking.seeds(best[0].parameter_set))
    return max(0, min(replicates.FEWEST_REPORTING, most - choosing) - reported)


def next_runs(ranking: Ranking, wanted: ReplicatesSpecification, room: int, affordable: int) -> list[tuple[int, int]]:
    """Returns the sets to run next, by their ids, each with a seed; empty when the best set is known and reported, or nothing is left.

    The first seeds choose the best set. The last ones then report it, so that its objective does not profit from the choice. Of a front,
    the set with the fewest runs is next: a set that a lucky run put there leaves it. Nothing reports it.

    Args:
        ranking: all sets.
        wanted: the campaign's settings.
        room: the largest number of runs.
        affordable: number of runs, each in all scenarios, that the budget has left.
    """
    kept = ranking.statistics()
    if kept is None or wanted.most < 2:
        return []
    choosing = replicates.choosing(wanted.most)
    fresh = range(choosing + 1, choosing + 1 if ranking.has_front else wanted.most + 1)
    # without a set, there is nothing to report
    spare = affordable - len(fresh) if ranking.to_show(kept[0][0]) == 0 else affordable
    numbers, known = (ranking.statistics(spare) if ranking.has_rates else None) or kept
    needed = {place: seeds for place, number in enumerate(numbers) if (seeds := ranking.to_show(number))}
    leader = known.best(wanted.confidence)
    rivals, open_ = [leader, *np.flatnonzero(known.ahead(leader) > 1 - wanted.confidence).tolist()], [leader]
    if ranking.has_front:
        members = {member.solution.parameter_set for member in ranking.front(hopeful=True)}
        rivals = open_ = [place for place, number in enumerate(numbers) if number in members]
    if any(needed.get(place, spare + 1) <= spare for place in open_) and known.counts.max() > 1:
        # of sets as good as the leader, as far as is known, the one with the fewest seeds left to show its rates is first
        place = min(rivals, key=lambda place: needed.get(place, choosing + 1))
        half = max(1, len(ranking.seeds(numbers[place])) // 2)  # of its seeds so far: a bad set is soon known
        places = [place] * min(room, needed[place], half)
    elif ranking.has_front:
        is_exact = known.is_known and not any(each.is_random or not each.is_known for each in ranking.by_objective()[1])
        room = 0 if is_exact else max(0, min(room, affordable))
        places = sorted(rivals, key=lambda place: len(ranking.seeds(numbers[place])))[:room]
    else:
        # a small budget reports by fewer runs
        report = (
            len(fresh) if known.is_known else min(len(fresh), max(replicates.FEWEST_REPORTING, affordable - replicates.FIRST))
        )
        second = int((known.counts - 1).sum())
        # the noise would stay unknown, and after the report another set might lead, which nothing reports
        if not known.is_known and second + affordable - report < replicates.FIRST:
            report = affordable
        places = replicates.allocate(known, min(room, affordable - report), choosing, wanted.confidence)
    # a seed without a result is not tried again
    untried = {place: sorted(set(range(1, choosing + 1)) - set(ranking.seeds(numbers[place]))) for place in places}
    chosen = [(numbers[place], untried[place].pop(0)) for place in places if untried[place]]
    if chosen or (known.is_known and not known.is_random) or (best := ranking.best()) is None:
        return chosen
    number = best[0].parameter_set
    left = [seed for seed in fresh if seed not in ranking.seeds(number)]
    return [(number, seed) for seed in left[:affordable]]

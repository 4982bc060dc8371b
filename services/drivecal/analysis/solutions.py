"""Ranks evaluated parameter sets by their weighted objective (Eq. 6) under any weights, without a simulation. Pure.

With several objectives or constraints, sets are ranked by the first objective, feasible ones first, and the others make a front.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cache
from math import isnan
from statistics import fmean
from typing import Any

import numpy as np

from drivecal.analysis import replicates
from drivecal.analysis.goals import Aggregate, Cells, Goals, Judged, normalised, over_seeds, weighted
from drivecal.analysis.replicates import SetStatistics
from drivecal.contracts.specification import ReplicatesSpecification
from drivecal.domain.evaluations import CellScore
from drivecal.domain.rounding import levels, same
from drivecal.plugins.ports import Floats


@dataclass(frozen=True, slots=True)
class EvaluatedSet:
    """A parameter set with a result in every weighted scenario; `iteration` and `individual` locate its first occurrence."""

    parameter_set: int
    objective: float
    rating: float
    scores: Mapping[str, float]
    reused: tuple[str, ...]
    """Scenarios whose score is copied or predicted, even if it counts for goals alone: this very set was not simulated there."""
    iteration: int
    individual: int
    judgement: Judged
    """All objectives and the violations."""
    sign: int
    """The first objective's sign: -1 if lower ones are better."""
    span: float
    """Width of the objective's declared range; 0 without one."""
    failed: tuple[str, ...] = ()
    """Weighted scenarios where each of its runs failed."""
    replicates: int = 1
    """Seeds under which it has a result in every scenario."""
    failures: int = 0
    """Runs that failed, or have no result, under all its seeds."""
    seeds: tuple[int, ...] = ()
    """Seeds whose runs make the objective, if it ran under several."""
    standard_error: float | None = None
    """Standard error of the objective; None without randomness, and before the noise is known."""
    lower: float | None = None
    upper: float | None = None
    """Interval of the objective."""
    probability_best: float | None = None
    """Probability that no other set has a better mean."""
    is_close: bool = False
    """It cannot be told from the best set."""
    runs_to_tell: int | None = None
    """Number of runs of this set and of the best set that would tell them apart; None if they are told apart, or equal so far."""
    bound: float | None = None
    """Least value of the objective at the confidence, which ranks the set; None: the objective."""
    chosen_by: "EvaluatedSet | None" = None
    """The set by the seeds that choose, if others report it."""

    @property
    def choice(self) -> "EvaluatedSet":
        """The set by the seeds that choose."""
        return self.chosen_by or self

    @property
    def violation(self) -> float:
        """Sum of the violations of constraints, in shares."""
        return self.judgement.violation

    @property
    def is_undecided(self) -> bool:
        """True if its runs do not decide whether it keeps its rates, and it keeps all other constraints."""
        return self.judgement.undecided

    def equals(self, other: "EvaluatedSet") -> bool:
        """Returns whether objective and violation are the same but for rounding."""
        return same(self.objective, other.objective, self.span) and same(self.violation, other.violation)


UNCOMPARED: dict[str, Any] = dict.fromkeys(("standard_error", "lower", "upper", "probability_best", "runs_to_tell", "bound"))
UNCOMPARED["is_close"] = False
"""Fields that a comparison with other sets fills in, with their values before it."""
UNUSUAL = 3.0
"""Variance of the differences of two sets, as a multiple of what the noise of all sets makes likely, from which on it counts alone."""


@dataclass(frozen=True, slots=True)
class FrontMember:
    """A set of the front by the seeds that choose, its answers by scenario, and the ids of all sets with its objectives."""

    solution: EvaluatedSet
    alike: frozenset[int]
    cells: Mapping[str, CellScore]

    @property
    def alternatives(self) -> int:
        """Number of sets with the same objectives."""
        return len(self.alike)


class SetJudge:
    """Makes sets of answers, by weights and goals. It keeps no answer."""

    def __init__(self, weights: Mapping[str, float], goals: Goals, wanted: ReplicatesSpecification) -> None:
        """See `Ranking`."""
        self.shares = normalised(weights)
        self.first = replace(goals.objectives[0], shares=self.shares) if goals.is_weighted_score else goals.objectives[0]
        self.goals = replace(goals, objectives=(self.first, *goals.objectives[1:]))
        self._is_rated = self.first.is_weighted_mean(self.shares)
        self.choosing, self.level = replicates.choosing(wanted.most), wanted.level
        judged = (*self.goals.objectives, *goals.bounds)
        bounding = {scenario for goal in judged for scenario in goal.shares}.difference(self.shares)
        self.scenarios = dict.fromkeys((*self.shares, *sorted(bounding))).keys()
        """Scenarios whose answers count, weighted ones first."""

    def of_cells(
        self, places: Iterable[tuple[int, int, int]], sets: Sequence[Cells], runs: Sequence[Sequence[Cells]] = ()
    ) -> Iterator[EvaluatedSet | None]:
        """Yields each set by its id, the place where it was first met, and its cells; None if a result is missing. `runs`: see
        `Goals.judge`."""
        counted = (cells.get(scenario) for cells in sets for scenario in self.shares)
        ratings = np.array([None if cell is None or cell.score is None else cell.rating for cell in counted], dtype=np.float64)
        rated = weighted(ratings.reshape(len(sets), len(self.shares)), self.shares.values()).tolist()
        for place, cells, rating, judgement in zip(places, sets, rated, self.goals.judge(sets, runs), strict=True):
            if judgement is None or isnan(rating):
                yield None
                continue
            scores = {scenario: score for scenario in self.shares if (score := cells[scenario].score) is not None}
            reused = tuple(scenario for scenario in self.scenarios if scenario in cells and not cells[scenario].own)
            objective, first = judgement.amounts[0], self.first
            rating = rating if self._is_rated else objective
            failed = tuple(scenario for scenario in scores if cells[scenario].failed)
            yield EvaluatedSet(
                place[0], objective, rating, scores, reused, *place[1:], judgement, first.sign, first.span, failed
            )

    def by_seed(
        self, places: Mapping[int, tuple[int, int]], runs: Mapping[int, Mapping[int, Cells]]
    ) -> Iterator[tuple[int, dict[int, EvaluatedSet]]]:
        """Yields the id of each set, and the set by each of its seeds with a result; none if a run failed under another seed of the choice:
        a mean over the other seeds would say too much. Seeds that report choose nothing: there a failure is counted, and a run that lacks
        what a constraint bounds counts for the objective."""
        cells = [by_seed[seed] for by_seed in runs.values() for seed in sorted(by_seed)]
        unbounded = copy(self)
        unbounded.goals = replace(self.goals, bounds=())
        judged = self.of_cells(((number, *places[number]) for number, by_seed in runs.items() for _ in by_seed), cells)
        for number, by_seed in runs.items():
            whole = dict[int, EvaluatedSet]()
            for seed, each in zip(sorted(by_seed), judged, strict=False):
                if each is None and seed > self.choosing and len(by_seed) > 1:
                    (each,) = unbounded.of_cells([(number, *places[number])], [by_seed[seed]])
                whole |= {} if each is None else {seed: each}
            without = [cells for seed, cells in by_seed.items() if seed not in whole and seed <= self.choosing]
            lost = any(cell.failed for cells in without for cell in cells.values())
            yield number, {} if lost else whole

    def over_seeds(self, by_seed: Mapping[int, EvaluatedSet], runs: Mapping[int, Cells]) -> tuple[EvaluatedSet | None, Cells]:
        """Returns a set by the means over its seeds, None without a result, and its cells by the seeds that choose."""
        if len(runs) == 1 or not by_seed:
            return next(iter(by_seed.values()), None), next(iter(runs.values()))
        fresh = [seed for seed in by_seed if seed > self.choosing]
        choosing = [seed for seed in by_seed if seed <= self.choosing] or fresh
        solution, cells = self._mean(by_seed, runs, choosing)
        if solution is None:
            return None, cells
        reported = self._mean(by_seed, runs, fresh)[0] if len(fresh) > 1 and choosing is not fresh else None
        if reported is not None:
            solution = replace(reported, chosen_by=replace(solution, replicates=len(choosing)))
        elif len(fresh) > 1 and choosing is not fresh:  # no run of the report has what a constraint bounds
            return None, cells
        failures = sum(cell.failed or cell.score is None for cells in runs.values() for cell in cells.values())
        return replace(solution, replicates=len(by_seed), failures=failures), cells

    def _mean(
        self, by_seed: Mapping[int, EvaluatedSet], runs: Mapping[int, Cells], seeds: Sequence[int]
    ) -> tuple[EvaluatedSet | None, Cells]:
        """Returns a set by the means over some of its seeds, with its objective over them, and these means."""
        partial = min(seeds) > self.choosing
        cells = {name: over_seeds([runs[seed][name] for seed in seeds], partial=partial) for name in runs[seeds[0]]}
        first, values = by_seed[seeds[0]], list(zip(*(by_seed[seed].judgement.amounts for seed in seeds), strict=True))
        place = first.parameter_set, first.iteration, first.individual
        (solution,) = self.of_cells([place], [cells], [self.counted(runs) or [cells]])
        if solution is None:
            return None, cells
        amounts = tuple(map(fmean, values))
        if self.level is not None:  # of one objective
            amounts = (Aggregate("quantile", self.level)(np.array(values), [1 / len(seeds)] * len(seeds)).item(),)
        judgement = replace(solution.judgement, amounts=amounts)
        return replace(solution, objective=amounts[0], judgement=judgement, seeds=tuple(seeds)), cells

    def counted(self, runs: Mapping[int, Cells]) -> list[Cells]:
        """Returns the cells of a set by seed that rates count: of the seeds that choose."""
        return [cells for seed, cells in sorted(runs.items()) if seed <= self.choosing]


class Ranking:
    """All parameter sets with their scores, under one choice of weights; grows as answers arrive."""

    def __init__(self, weights: Mapping[str, float], goals: Goals, wanted: ReplicatesSpecification | None = None) -> None:
        """`weights` by scenario need not be normalised; scenarios of weight 0 and those not named count for goals alone. `goals`: their
        first objective ranks. `wanted`: replicates of a random simulator."""
        self._wanted = wanted or ReplicatesSpecification()
        self._judge = SetJudge(weights, goals, self._wanted)
        self._goals, self._choosing, self._level = self._judge.goals, self._judge.choosing, self._judge.level
        self.scenarios = self._judge.scenarios
        self.has_front = len(goals.objectives) > 1
        """Several objectives make a front."""
        self.has_rates = any(bound.rate is not None for bound in goals.bounds)
        """A constraint is on a rate."""
        self._runs: dict[int, dict[int, dict[str, CellScore]]] = {}
        """Answers by set, seed and scenario."""
        self._samples: dict[int, dict[int, float]] = {}
        """Objectives by set and seed, of sets with several seeds."""
        self._shown: dict[int, int] = {}
        """Further seeds that show the rates of sets."""
        self.statistics = cache(self._statistics)
        """See `_statistics`."""
        self._varies = False
        """Ratings of a set differ between seeds, so that equal scores, which have steps, do not say that there is no noise."""
        self._is_assessed = True
        self._known: SetStatistics | None = None
        """Statistics of the sets as of the last assessment; None while no set has several seeds."""
        self._answers: dict[int, Cells] = {}
        """Answers by set and scenario: means over the seeds that choose."""
        self._places: dict[int, tuple[int, int]] = {}
        self._solutions: dict[int, EvaluatedSet] = {}
        self._predicted: dict[int, EvaluatedSet] = {}
        """Sets with a predicted score, which have no rank."""
        self._surest_front: list[Judged] | None = None
        self._best: tuple[EvaluatedSet, int] | None = None
        self._levels: dict[int, tuple[int, int]] | None = None
        """Places among the distinct violations and objectives, best first, by the id of a set."""

    def add(self, answers: Iterable[CellScore]) -> None:
        """Takes answers in, in any order. A set with a predicted score takes no place in the ranking."""
        touched: set[int] = set()
        for answer in answers:
            if answer.scenario not in self.scenarios:
                continue
            number, place = answer.parameter_set, (answer.iteration, answer.individual)
            if place < self._places.setdefault(number, place):
                self._places[number] = place
            cells = self._runs.setdefault(number, {}).setdefault(answer.seed, {})
            known = cells.get(answer.scenario)
            if known is None or answer.worth > known.worth:
                cells[answer.scenario] = answer
            touched.add(number)
        self._surest_front = self._best = self._levels = None
        self._is_assessed = False
        self.statistics.cache_clear()
        for number, by_seed in self._judge.by_seed(self._places, {number: self._runs[number] for number in touched}):
            runs = self._runs[number]
            self._shown.pop(number, None)
            self._samples.pop(number, None)  # a run that failed since may have no value
            if by_seed and len(runs) > 1:
                self._samples[number] = {seed: each.objective for seed, each in by_seed.items()}
                self._varies |= len({each.rating for each in by_seed.values()}) > 1
            solution, self._answers[number] = self._judge.over_seeds(by_seed, runs)
            is_predicted = any(cell.predicted for cell in self._answers[number].values())
            for sets, belongs in ((self._predicted, is_predicted), (self._solutions, not is_predicted)):
                if solution is not None and belongs:
                    sets[number] = solution
                else:
                    sets.pop(number, None)

    @property
    def sets(self) -> int:
        """Number of sets with an answer."""
        return len(self._runs)

    def own_scores(self, scenario: str) -> dict[int, float]:
        """Returns the scores of all sets that were simulated in a scenario, given-up ones as well, by their ids, in the order of
        discovery: means over the seeds that choose."""
        scores = dict[int, float]()
        for number in sorted(self._runs, key=self._places.__getitem__):
            runs = (cells.get(scenario) for seed, cells in self._runs[number].items() if seed <= self._choosing)
            own = [float(cell.score) for cell in runs if cell is not None and cell.own and cell.score is not None]
            if own:
                scores[number] = fmean(own)
        return scores

    def order(self, solution: EvaluatedSet) -> tuple[int, int, int, float, int, int]:
        """Sorts best first: feasible sets first, of equal objectives the one with the most runs, then by the weighted continuous rating,
        then by discovery."""
        level = self._leveled()[solution.parameter_set]
        rating = -solution.sign * solution.choice.rating
        runs = len(self.seeds(solution.parameter_set))
        return *level, -runs, rating, solution.iteration, solution.individual

    def _leveled(self) -> dict[int, tuple[int, int]]:
        self._assess()
        if self._levels is None:
            known = list((self._solutions | self._predicted).values())
            reached = [-each.sign * (each.choice.objective if each.bound is None else each.bound) for each in known]
            violations = levels(np.array([each.choice.violation for each in known])).tolist()
            objectives = levels(np.array(reached), self._judge.first.span).tolist()
            numbers = (each.parameter_set for each in known)
            self._levels = dict(zip(numbers, zip(violations, objectives, strict=True), strict=True))
        return self._levels

    def close(self) -> int:
        """Returns how many sets cannot be told from the best one."""
        return sum(each.is_close for each in self._solutions.values())

    def failed_runs(self, parameter_set: int) -> tuple[int, int]:
        """Returns the number of a set's failed runs, and of its runs: only runs that report it, if there are any."""
        runs = self._runs[parameter_set]
        used = [seed for seed in self.seeds(parameter_set) if seed > self._choosing] or list(runs)
        cells = [cell.failed or cell.score is None for seed in used for cell in runs[seed].values()]
        return sum(cells), len(cells)

    def noise(self) -> dict[str, float]:
        """Returns the deviation of a run's score by scenario, without what sets have in common, as far as it is known."""
        noise: dict[str, float] = {}
        repeated = [self._runs[number] for number in sorted(self._samples, key=self._places.__getitem__)]
        for scenario in self._judge.shares:
            cells = ({seed: run[scenario] for seed, run in runs.items() if scenario in run} for runs in repeated)
            known = [{seed: cell.score for seed, cell in each.items() if not cell.failed} for each in cells]
            samples = _by_seed([each for each in known if any(score is not None for score in each.values())])
            if len(samples) and (deviation := replicates.assess(samples).noise) is not None:
                noise[scenario] = deviation
        return noise

    def seeds(self, parameter_set: int) -> set[int]:
        """Returns the seeds under which a set was run in all scenarios, with or without a result."""
        return {seed for seed, cells in self._runs.get(parameter_set, {}).items() if cells.keys() >= self.scenarios}

    def to_show(self, parameter_set: int, *, ever: bool = False) -> int | None:
        """Returns under how many further seeds a set shows that it keeps all constraints, if no further run is beyond a limit: 0 if it has
        shown it by the seeds that choose. None if the seeds left to choose do not suffice, or, `ever`, a million, or if it breaks one."""
        judgement, seeds_run = self._solutions[parameter_set].choice.judgement, self.seeds(parameter_set)
        if not judgement.undecided:
            return None if judgement.broken else 0
        left = 1_000_000 if ever else sum(seed not in seeds_run for seed in range(1, self._choosing + 1))
        if parameter_set not in self._shown:
            counted = self._judge.counted(self._runs[parameter_set])
            rates = [bound for bound in self._goals.bounds if bound.rate is not None]
            self._shown[parameter_set] = max(bound.seeds_to_show(counted, 1_000_000) for bound in rates)
        return shown if (shown := self._shown[parameter_set]) <= left else None

    def _statistics(self, seeds: int = 0) -> tuple[list[int], SetStatistics] | None:
        """Returns what is known of the sets by the seeds that choose, and their ids; None without a set. Sets that keep all
        constraints, or may show it under this many further `seeds`, or else all sets."""
        ids = sorted(self._solutions, key=self._places.__getitem__)  # sums depend on the order, and ids on other campaigns
        known = {
            number: self._samples.get(number) or {min(self._runs[number]): self._solutions[number].objective} for number in ids
        }
        by_seed = {number: {seed: known[number][seed] for seed in known[number] if seed <= self._choosing} for number in ids}
        numbers = [number for number, objectives in by_seed.items() if objectives]
        if not numbers:
            return None
        further = [self.to_show(number) for number in numbers]
        kept = [place for place, needed in enumerate(further) if needed is not None and needed <= seeds]
        sign, counted = self._judge.first.sign, [(by_seed[number], self._runs[number]) for number in numbers]
        samples = sign * _by_seed([objectives for objectives, _ in counted])
        failed = [{seed: any(cell.failed for cell in runs[seed].values()) for seed in each} for each, runs in counted]
        level = self._level if self._level is None or sign > 0 else 1 - self._level
        standing = replicates.assess(samples, level, _by_seed(failed) == 1, kept or None)
        if self._varies and standing.is_known and not standing.is_random:
            unknown = np.full_like(standing.means, np.nan)
            standing = replace(standing, variances=unknown, spreads=unknown)
        return [numbers[place] for place in kept] or numbers, standing

    def by_objective(self) -> tuple[list[int], list[SetStatistics]]:
        """Returns what the seeds that choose say of each objective, and the ids of the sets; nothing while no set has several seeds."""
        if not self._samples:
            return [], []
        runs = {number: self._runs[number] for number in sorted(self._solutions, key=self._places.__getitem__)}
        judged = ((number, by_seed.items()) for number, by_seed in self._judge.by_seed(self._places, runs))
        chosen = {number: {seed: each for seed, each in by_seed if seed <= self._choosing} for number, by_seed in judged}
        kept = {number: by_seed for number, by_seed in chosen.items() if by_seed}
        known = list[SetStatistics]()
        for at, goal in enumerate(self._goals.objectives):
            amounts = [{seed: goal.sign * each.judgement.amounts[at] for seed, each in sets.items()} for sets in kept.values()]
            known.append(replicates.assess(_by_seed(amounts)))
        return list(kept), known

    def _assess(self) -> None:
        """Adds intervals and probabilities to the solutions, if their runs are random."""
        if self._is_assessed:
            return
        self._is_assessed, self._known, confidence = True, None, self._wanted.confidence
        statistics = self.statistics() if self._samples else None
        if statistics is None:
            return
        numbers, known = statistics
        self._known, self._levels = known, None
        for number in self._solutions.keys() - set(numbers):  # compared before the first set kept the constraints
            self._solutions[number] = replace(self._solutions[number], **UNCOMPARED)
        for place, number in enumerate(numbers):
            fresh = [objective for seed, objective in sorted(self._samples.get(number, {}).items()) if seed > self._choosing]
            if len(fresh) > 1:
                others = (0.0, 0.0)
                if known.is_known and self._level is None:  # runs under one seed have much in common
                    others = float(known.spreads[place]), float(known.spread_freedom[place])
                solution = self._solutions[number]
                error = float((replicates.variance(fresh, *others) / len(fresh)) ** 0.5) * replicates.widening(self._level)
                lower, upper = replicates.interval(fresh, self._level, confidence, *others, solution.sign * known.skewness)
                self._solutions[number] = replace(solution, lower=lower, upper=upper, standard_error=error)
        leader = known.best(confidence)
        if not known.is_known:  # too few runs tell no set from the best one
            for number in set(numbers) - {numbers[leader]}:
                self._solutions[number] = replace(self._solutions[number], is_close=True)
            return
        if self.has_rates:  # which rank first
            self._compare_undecided(numbers[leader])
        probabilities = np.full(len(numbers), np.nan) if self.has_rates else known.probabilities
        ahead, halves, errors = known.ahead(leader), known.half_widths(confidence), known.standard_errors
        bounds = known.bounds(confidence)
        for place, number in enumerate(numbers):
            solution = self._solutions[number]
            is_reported, half = solution.chosen_by is not None, float(halves[place])
            close = place != leader and ahead[place] > 1 - confidence
            middle = solution.objective if self._level is None else solution.sign * float(known.means[place])
            self._solutions[number] = replace(
                solution,
                standard_error=solution.standard_error if is_reported else float(errors[place]),
                # runs that chose the best set say too much of it
                lower=solution.lower if is_reported else None if place == leader else middle - half,
                upper=solution.upper if is_reported else None if place == leader else middle + half,
                probability_best=None if np.isnan(probabilities[place]) else float(probabilities[place]),
                is_close=bool(close),
                runs_to_tell=replicates.to_tell(known, leader, place, confidence) if close else None,
                bound=solution.sign * float(bounds[place]),
            )

    def _compare_undecided(self, leader: int) -> None:
        """Notes sets close to the leader that may still show that they keep their rates."""
        numbers, known = self.statistics(seeds=1_000_000) or ([], None)
        if known is not None and leader in numbers:
            for number, share in zip(numbers, known.ahead(numbers.index(leader)), strict=True):
                is_close = share > 1 - self._wanted.confidence
                self._solutions[number] = replace(self._solutions[number], is_close=bool(is_close))

    def best_first(self) -> list[EvaluatedSet]:
        """All solutions, best first."""
        self._assess()
        return sorted(self._solutions.values(), key=self.order)

    def best(self) -> tuple[EvaluatedSet, int] | None:
        """The best solution and how many share its objective, itself included; None before the first."""
        if not self._solutions or self._best is not None:
            return self._best
        known = self._leveled()
        first = min(known[number] for number in self._solutions)
        alike = [solution for number, solution in self._solutions.items() if known[number] == first]
        self._best = min(alike, key=self.order), len(alike)
        return self._best

    def surest(self) -> EvaluatedSet | None:
        """The best solution whose scores are all its own; None without one."""
        own = (solution for solution in self._solutions.values() if not solution.reused)
        return min(own, key=self.order, default=None)

    def doubtful(self, tried: Collection[int] = ()) -> EvaluatedSet | None:
        """The best set with a copied or predicted score that would rank before `surest`, except those `tried` (ids); None without one."""
        if self._goals.is_vector:
            return self._doubtful_on_front(tried)
        surest = self.surest()
        candidates = [
            candidate
            for number, candidate in (self._solutions | self._predicted).items()
            if candidate.reused and number not in tried and (surest is None or self.order(candidate) < self.order(surest))
        ]
        return min(candidates, key=self.order, default=None)

    def dismissed(self) -> dict[int, Mapping[str, CellScore]]:
        """The answers of the sets with a predicted score, the best believed set first, by their ids."""
        return {row.parameter_set: self._answers[row.parameter_set] for row in sorted(self._predicted.values(), key=self.order)}

    def predicted(self, parameter_set: int) -> EvaluatedSet | None:
        """A set with a predicted score; None for others."""
        return self._predicted.get(parameter_set)

    def front(self, *, hopeful: bool = False) -> list[FrontMember]:
        """The sets that no other set dominates, best first objective first, each vector of objectives once: of equal ones a set whose
        scores are all its own, then the first of the ranking. Infeasible ones only while none is feasible; if `hopeful`, sets that may
        still show their rates count as feasible. Of one objective the best."""
        self._assess()
        return self._front(self._solutions.values(), hopeful=hopeful)

    def reaches_front(self, cells: Mapping[str, CellScore]) -> bool:
        """Returns whether no set with scores of its own dominates one with these cells, nor has the same objectives."""
        (judgement,) = self._goals.judge([cells])
        if judgement is None:
            return False
        known = self._sure_front()
        points, point = self._goals.signed(known), np.array(self._goals.compared(judgement))
        as_good = np.all(points - point >= -self._goals.slacks(points, point), axis=1)
        return not any(
            is_as_good if same(each.violation, judgement.violation) else each.violation < judgement.violation
            for each, is_as_good in zip(known, as_good.tolist(), strict=True)
        )

    def _sure_front(self) -> list[Judged]:
        if self._surest_front is None:
            own = self._front(solution for solution in self._solutions.values() if not solution.reused)
            self._surest_front = [member.solution.judgement for member in own]
        return self._surest_front

    def _doubtful_on_front(self, tried: Collection[int]) -> EvaluatedSet | None:
        """The first doubtful set of the front that all sets would make, but for those tried. Without one, the best set if it is doubtful:
        a copied set may rank before one of its own scores and equal objectives, in whose place the front does not hold it."""
        believed = [
            solution
            for number, solution in (self._solutions | self._predicted).items()
            if not solution.reused or number not in tried
        ]
        on_front = next((member.solution for member in self._front(believed) if member.solution.reused), None)
        best = None if on_front is not None else self.best()
        return on_front if best is None or not best[0].reused or best[0].parameter_set in tried else best[0]

    def _front(self, solutions: Iterable[EvaluatedSet], *, hopeful: bool = False) -> list[FrontMember]:
        judged = list(solutions)
        if not judged:
            return []
        points = self._goals.signed(each.choice.judgement for each in judged)
        if not self._goals.is_vector and any(each.bound is not None for each in judged):  # the best sample is luck
            least = min(self.order(each)[:2] for each in judged)
            kept = np.array([self.order(each)[:2] == least for each in judged])
        else:
            violations = [0.0 if hopeful and each.choice.is_undecided else each.choice.violation for each in judged]
            kept = self._goals.leading(points, np.array(violations))
        ordered = sorted(np.flatnonzero(kept).tolist(), key=lambda place: self.order(judged[place]))
        alike = [[judged[ordered[place]] for place in group] for group in self._goals.alike(points[ordered])]
        members = [
            FrontMember(first.choice, frozenset(each.parameter_set for each in sets), self._answers[first.parameter_set])
            for sets in alike
            for first in [min(sets, key=lambda each: bool(each.reused))]
        ]
        return sorted(members, key=lambda member: self.order(member.solution))

    def get(self, parameter_set: int, *, compared: bool = True) -> EvaluatedSet | None:
        """A parameter set's solution, by its id, None if a result is missing; sooner if it need not be `compared` with others."""
        if compared:
            self._assess()
        return self._solutions.get(parameter_set)

    def gain_over(self, parameter_set: int, *, random: bool) -> tuple[float | None, bool]:
        """Returns how much better the best set is than another one, by its id, under the seeds that report both, None without two of them,
        and whether runs do not tell which is better (Student's test of the differences). `random`: the simulator says so."""
        from scipy.special import stdtrit

        best, solution, known = self.best(), self.get(parameter_set), self._known
        if best is None or solution is None or best[0].parameter_set == parameter_set:
            return None, False
        numbers = best[0].parameter_set, parameter_set
        one, other = (self._samples.get(number, {}) for number in numbers)
        shared = [seed for seed in one.keys() & other.keys() if seed > self._choosing]
        gains = [solution.sign * (one[seed] - other[seed]) for seed in shared]
        if len(gains) < 2 or self._level is not None:
            is_single = random and len(other) < 2 and (known is None or known.is_random or not known.is_known)
            return None, solution.is_close or is_single
        noise, freedom, usual, own = 0.0, 0.0, None, float(np.var(gains, ddof=1))
        runs = [(seed, cells) for number in numbers for seed, cells in self._runs[number].items() if seed > self._choosing]
        failing = {seed for seed, cells in runs if any(cell.failed for cell in cells.values())}
        if known is not None:  # failures of other sets say nothing of runs that did not fail
            sound = known.sound_noise if failing.isdisjoint(shared) else None
            usual = known.noise if sound is None else sound
        if known is not None and usual is not None:
            noise, freedom = 2 * usual**2, min(replicates.SHRINKAGE, float(known.freedom.max()))
        if own > UNUSUAL * noise:  # one of the two is noisier than others, which say nothing of it then
            noise, freedom = 0.0, 0.0
        error = (replicates.variance(gains, noise, freedom) / len(gains)) ** 0.5
        is_close = abs(fmean(gains)) <= stdtrit(freedom + len(gains) - 1, self._wanted.confidence) * error
        return fmean(gains), bool(is_close or (failing and failing.isdisjoint(shared)))  # the gain lacks what failures cost

    def beside_best(self, parameter_set: int, seeds: Collection[int] | None = None) -> tuple[EvaluatedSet, EvaluatedSet] | None:
        """Returns the best set and another one, by its id, under the seeds that both were run under: what a seed does to all sets is no
        difference. None without a result of both. `seeds`: these alone; None without any, if the best set lacks one, or if one
        chose the best set."""
        best, sides = self.best(), list[EvaluatedSet]()
        shared = set() if best is None else self.seeds(best[0].parameter_set) & self.seeds(parameter_set)
        if seeds is not None:
            shared = set(seeds) if shared.issuperset(seeds) and min(seeds, default=0) > self._choosing else set()
        for number in (best[0].parameter_set, parameter_set) if best is not None and shared else ():
            runs = {seed: self._runs[number][seed] for seed in shared}
            ((_, by_seed),) = self._judge.by_seed(self._places, {number: runs})
            sides += filter(None, self._judge.over_seeds(by_seed, runs)[:1])
        return (sides[0], sides[1]) if len(sides) > 1 else None


def _by_seed(rows: Sequence[Mapping[int, float | None]]) -> Floats:
    """Returns values of sets by seed, shape (n, n_seeds); NaN without one."""
    table = np.full((len(rows), max((max(row) for row in rows), default=0)), np.nan)
    for place, row in enumerate(rows):
        table[place, np.array(list(row), dtype=np.int64) - 1] = np.array(list(row.values()), dtype=np.float64)
    return table

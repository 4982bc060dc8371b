"""Comparison of campaigns with several optimizers, population sizes, seeds and reductions (Section IV-B, Table 5). Pure."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from statistics import fmean, stdev
from typing import Any, NamedTuple

from drivecal.analysis.convergence import alternatives_at, best_at
from drivecal.contracts.comparison import ComparedGroup, ComparedPair, Improvement, ReductionEffect
from drivecal.domain.rounding import grain, same

CONFIDENCE = 0.95


def labels(settings: Sequence[Mapping[str, Any]], by: str) -> list[str]:
    """Returns a label for each optimizer or reduction: its value of `by`, with the settings in which others of that value differ."""
    fixed: dict[object, dict[str, Any]] = {}
    varied: dict[object, dict[str, None]] = {}
    for each in settings:
        first = fixed.setdefault(each[by], dict(each))
        differing = [name for name in (*first, *each) if first.get(name) != each.get(name)]
        varied.setdefault(each[by], {}).update(dict.fromkeys(differing))
    return [" ".join([each[by], *(f"{name}={each[name]}" for name in varied[each[by]] if name in each)]) for each in settings]


class Conditions(NamedTuple):
    """Conditions of a run."""

    optimizer: str
    population: int
    seed: int
    reduction: str


@dataclass(frozen=True, slots=True)
class Course:
    """Course of a run by finished iteration: the best objective by then, the rating of the best set, how many sets shared the objective,
    the population's mean, and cells that had to be simulated, for they had no answer among the run's own. `ended`: it went to its end."""

    campaign: str
    """The id of the run's campaign."""
    conditions: Conditions
    best: Sequence[float | None]
    ratings: Sequence[float | None]
    alternatives: Sequence[int]
    means: Sequence[float | None]
    simulations: Sequence[int]
    ended: bool
    reused: bool = False
    """True if references or predictions answered any cell."""
    simulated_best: float | None = None
    """Then: the best objective of a set whose every score was simulated for itself."""
    confirmations: int = 0
    """Simulations after the search, by which its best set was confirmed."""

    @property
    def optimum(self) -> float | None:
        """The best objective of the whole run that is true of its set; None before any result. What is reused may be off, and a
        search prefers what is off upwards, so scores of references count for the search and not here. Of a confirmed run it is that of
        the first set of its ranking, of others a lower bound."""
        believed = self.best[-1] if self.best else None
        if not self.reused:
            return believed
        simulated = self.simulated_best
        return believed if simulated is not None and same(simulated, believed) else simulated

    @property
    def simulated(self) -> int:
        """Simulations of the whole run."""
        return sum(self.simulations) + self.confirmations

    def best_after(self, simulations: int) -> float | None:
        """Returns the best objective that the search had believed in after a number of simulations; None before the first."""
        taken = accumulate(self.simulations)
        return next((best for used, best in reversed(list(zip(taken, self.best, strict=True))) if used <= simulations), None)

    @property
    def improvements(self) -> list[Improvement]:
        """The first iteration with a result, those that improved on it, and the last one."""
        listed: list[Improvement] = []
        taken = accumulate(self.simulations)
        for iteration, (simulations, best, rating) in enumerate(zip(taken, self.best, self.ratings, strict=True), start=1):
            changed = not listed or (best, rating) != (listed[-1].best, listed[-1].rating)
            if best is not None and (changed or iteration == len(self.best)):
                listed.append(Improvement(iteration=iteration, simulations=simulations, best=best, rating=rating))
        return listed

    @property
    def converged_at(self) -> int | None:
        """Table 5, counted from 1."""
        return best_at(self.best)

    @property
    def alternatives_converged_at(self) -> int | None:
        """Table 7, counted from 1."""
        return alternatives_at(self.best, self.alternatives)

    @property
    def simulations_to_converge(self) -> int | None:
        """Simulations up to and with the iteration in which it had converged."""
        at = self.converged_at
        return None if at is None else sum(self.simulations[:at])


def best_of_all(courses: Iterable[Course], sign: int = 1) -> float | None:
    """The best optimum of all runs; None if no run has one. `sign`: -1 if lower objectives are better."""
    return best_of((course.optimum for course in courses), sign)


def best_of(objectives: Iterable[float | None], sign: int = 1) -> float | None:
    """The best objective; None without one."""
    return max((value for value in objectives if value is not None), key=lambda value: sign * value, default=None)


def succeeds(course: Course, best: float | None, sign: int = 1) -> bool:
    """Returns whether a run found an optimum as good as `best`."""
    return best is not None and course.optimum is not None and sign * (course.optimum - best) >= -grain(best)


def groups(courses: Sequence[Course], sign: int = 1) -> list[ComparedGroup]:
    """Runs with equal optimizer, population and reduction together, in the order of the first of each."""
    best = best_of_all(courses, sign)
    courses_by_group: dict[tuple[str, int, str], list[Course]] = {}
    for course in courses:
        conditions = course.conditions
        courses_by_group.setdefault((conditions.optimizer, conditions.population, conditions.reduction), []).append(course)
    common = min((sum(course.simulations) for course in courses if course.best), default=0)
    marks = sorted({mark for mark in (common // 4, common // 2, common) if mark})
    return [_group(*key, members, best, sign, marks) for key, members in courses_by_group.items()]


def _group(
    optimizer: str,
    population: int,
    reduction: str,
    members: Sequence[Course],
    best: float | None,
    sign: int,
    marks: Sequence[int],
) -> ComparedGroup:
    optima = [member.optimum for member in members if member.optimum is not None]
    begun = [member for member in members if member.best]
    converged = [member for member in members if member.converged_at is not None]
    return ComparedGroup(
        optimizer=optimizer,
        population=population,
        reduction=reduction,
        seeds=len(members),
        best=best_of(optima, sign),
        mean=_mean(optima),
        minimum=best_of(optima, -sign),
        rating=_mean([run.ratings[-1] for run in begun if run.ratings[-1] is not None]),
        alternatives=_mean([run.alternatives[-1] for run in begun]),
        simulations=_mean([run.simulated for run in begun]),
        converged=len(converged),
        iterations_to_converge=_mean([course.converged_at or 0 for course in converged]),
        simulations_to_converge=_mean([course.simulations_to_converge or 0 for course in converged]),
        successes=sum(succeeds(member, best, sign) for member in members),
        after={mark: _mean([value for run in begun if (value := run.best_after(mark)) is not None]) for mark in marks},
    )


def _mean(values: Sequence[float]) -> float | None:
    return fmean(values) if values else None


@dataclass(frozen=True, slots=True)
class Pair:
    """Two runs to their ends that differ in the reduction alone: `base` has the first one's."""

    run: Course
    base: Course

    @property
    def difference(self) -> float:
        """The optimum with the reduction less the one without; 0 if they are equal but for rounding."""
        result, base = self.run.optimum or 0.0, self.base.optimum or 0.0
        return 0.0 if same(result, base) else result - base

    @property
    def saved(self) -> int:
        """Simulations that the reduction saved."""
        return self.base.simulated - self.run.simulated


def pairs(courses: Sequence[Course]) -> list[Pair]:
    """Each run with another reduction than the first one's beside the run with the first one and equal optimizer, population and seed.
    Leaves out pairs in which a run has no optimum or did not go to its end."""
    if not courses:
        return []
    first = courses[0].conditions.reduction
    whole = {course.conditions: course for course in courses if course.ended and course.optimum is not None}
    return [
        Pair(course, whole[base])
        for conditions, course in whole.items()
        if conditions.reduction != first and (base := conditions._replace(reduction=first)) in whole
    ]


def pair_row(pair: Pair) -> ComparedPair:
    """Returns a pair's row in the response."""
    conditions = pair.run.conditions
    return ComparedPair(
        **conditions._asdict(),
        base=pair.base.conditions.reduction,
        campaign=pair.run.campaign,
        base_campaign=pair.base.campaign,
        best=pair.run.optimum or 0.0,
        base_best=pair.base.optimum or 0.0,
        difference=pair.difference,
        simulations=pair.run.simulated,
        base_simulations=pair.base.simulated,
        saved=pair.saved,
    )


def effects(pairs: Sequence[Pair], sign: int = 1) -> list[ReductionEffect]:
    """Effects by reduction, optimizer and population, and, if there are several such groups, of each reduction over all of them."""
    wanted: dict[tuple[str, str | None, int | None], list[Pair]] = {}
    for course in pairs:
        conditions = course.run.conditions
        wanted.setdefault((conditions.reduction, conditions.optimizer, conditions.population), []).append(course)
    for reduction in dict.fromkeys(course.run.conditions.reduction for course in pairs):
        parts = [listed for key, listed in wanted.items() if key[0] == reduction]
        if len(parts) > 1:
            wanted[reduction, None, None] = [course for listed in parts for course in listed]
    return [_effect(*key, listed, sign) for key, listed in wanted.items()]


def _effect(
    reduction: str, optimizer: str | None, population: int | None, listed: Sequence[Pair], sign: int
) -> ReductionEffect:
    from scipy import stats  # more than a second, which only those pay who compare

    differences = [course.difference for course in listed]
    better = sum(sign * difference > 0 for difference in differences)
    worse = sum(sign * difference < 0 for difference in differences)
    different, mean = better + worse, fmean(differences)
    margin = None
    if len(differences) > 1 and stdev(differences) > grain(mean):  # without any spread the t distribution says nothing
        quantile = float(stats.t.ppf((1 + CONFIDENCE) / 2, len(differences) - 1))
        margin = quantile * stdev(differences) / len(differences) ** 0.5
    interval = stats.binomtest(different, len(differences)).proportion_ci(CONFIDENCE, method="exact")
    with_it, without = (sum(run.simulated for run in runs) for runs in zip(*((p.run, p.base) for p in listed), strict=True))
    return ReductionEffect(
        optimizer=optimizer,
        population=population,
        reduction=reduction,
        base=listed[0].base.conditions.reduction,
        pairs=len(listed),
        mean_difference=mean,
        lower_95=None if margin is None else mean - margin,
        upper_95=None if margin is None else mean + margin,
        better=better,
        equal=len(differences) - different,
        worse=worse,
        sign_test=float(stats.binomtest(better, different).pvalue) if different else 1.0,
        different_upper_95=float(interval.high),
        simulations=with_it,
        base_simulations=without,
        saved_share=(without - with_it) / without if without else 0.0,
    )

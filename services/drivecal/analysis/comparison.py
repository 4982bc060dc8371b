"""Comparison of campaigns with several optimizers, population sizes, seeds and reductions (Section IV-B, Table 5). Pure."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from statistics import fmean
from typing import Any, NamedTuple

from drivecal.analysis.convergence import best_at
from drivecal.contracts.campaign import OutcomeCounts
from drivecal.contracts.comparison import ComparedGroup, Improvement
from drivecal.contracts.tables import Generation
from drivecal.domain.rounding import grain, same


def labels(settings: Sequence[Mapping[str, Any]], by: str) -> list[str]:
    """Returns a label for each optimizer or reduction: its value of `by`, and settings that distinguish it from others with that value."""
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
    """Course of a run by finished iteration."""

    campaign: str
    """The id of the run's campaign."""
    conditions: Conditions
    iterations: Sequence[Generation]
    surest: float | None = None
    """Best objective of a set whose scores are all its own."""
    confirmations: int = 0
    """Simulations after the search that confirm its best set."""
    is_random: bool = False
    """During the search the best objective is luck; only the reported objective counts."""

    @property
    def best(self) -> list[float | None]:
        """The best objective by each iteration."""
        return [each.best for each in self.iterations]

    @property
    def simulations(self) -> list[int]:
        """Cells of each iteration that had to be simulated, for they had no answer among the run's own."""
        return [needed(each) for each in self.iterations]

    @property
    def optimum(self) -> float | None:
        """The best objective of the whole run whose scores were simulated; None before any result. Scores of references do not count here:
        they may be wrong, and a search prefers sets with an error upwards. For a confirmed run, this is the objective of the first set of
        its ranking; for others, it is a lower bound."""
        if self.is_random:
            return self.surest
        believed = self.iterations[-1].best if self.iterations else None
        is_surest = self.surest is not None and same(self.surest, believed)
        return believed if is_surest or not any(each.reused or each.predicted for each in self.iterations) else self.surest

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
        """The first iteration with a result, each iteration that improved the best set, and the last iteration."""
        listed: list[Improvement] = []
        taken = accumulate(self.simulations)
        for number, (simulations, each) in enumerate(zip(taken, self.iterations, strict=True), start=1):
            changed = not listed or (each.best, each.rating) != (listed[-1].best, listed[-1].rating)
            if each.best is not None and (changed or number == len(self.iterations)):
                listed.append(Improvement(iteration=number, simulations=simulations, best=each.best, rating=each.rating))
        return listed

    @property
    def converged_at(self) -> int | None:
        """Table 5, counted from 1."""
        return best_at(self.best)

    @property
    def simulations_to_converge(self) -> int | None:
        """Number of simulations to the end of the iteration `converged_at`."""
        at = self.converged_at
        return None if at is None else sum(self.simulations[:at])


def needed(cells: OutcomeCounts) -> int:
    """Returns the requested cells without an answer from the campaign's own: simulated, by this or another campaign, or failed."""
    return cells.requested - cells.repeated - cells.reused - cells.predicted


def best_of(objectives: Iterable[float | None], sign: int = 1) -> float | None:
    """The best objective; None without one. `sign`: -1 if lower objectives are better."""
    return max((value for value in objectives if value is not None), key=lambda value: sign * value, default=None)


def succeeds(course: Course, best: float | None, sign: int = 1) -> bool:
    """Returns whether a run found an optimum as good as `best`."""
    return best is not None and course.optimum is not None and sign * (course.optimum - best) >= -grain(best)


def groups(courses: Sequence[Course], sign: int = 1) -> list[ComparedGroup]:
    """Runs with equal optimizer, population and reduction together, in the order of the first of each."""
    best = best_of((course.optimum for course in courses), sign)
    courses_by_group: dict[tuple[str, int, str], list[Course]] = {}
    for course in courses:
        conditions = course.conditions
        courses_by_group.setdefault((conditions.optimizer, conditions.population, conditions.reduction), []).append(course)
    common = min((sum(course.simulations) for course in courses if course.iterations and not course.is_random), default=0)
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
    begun = [member for member in members if member.iterations]
    last = [member.iterations[-1] for member in begun if not member.is_random]
    converged = [member for member in members if member.converged_at is not None]
    return ComparedGroup(
        optimizer=optimizer,
        population=population,
        reduction=reduction,
        seeds=len(members),
        best=best_of(optima, sign),
        mean=_mean(optima),
        minimum=best_of(optima, -sign),
        rating=_mean([each.rating for each in last if each.rating is not None]),
        alternatives=_mean([each.alternatives for each in last]),
        simulations=_mean([run.simulated for run in begun]),
        converged=len(converged),
        iterations_to_converge=_mean([course.converged_at or 0 for course in converged]),
        simulations_to_converge=_mean([course.simulations_to_converge or 0 for course in converged]),
        successes=None if any(run.is_random for run in begun) else sum(succeeds(member, best, sign) for member in members),
        after={mark: _mean([value for run in begun if (value := run.best_after(mark)) is not None]) for mark in marks},
    )


def _mean(values: Sequence[float]) -> float | None:
    return fmean(values) if values else None

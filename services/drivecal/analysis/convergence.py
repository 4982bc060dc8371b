"""Iterations at which an optimization had its final result (Tables 5 and 7 of the paper)."""

from collections.abc import Sequence
from itertools import accumulate, pairwise

from drivecal.contracts.tables import Generation
from drivecal.domain.rounding import same

Course = Sequence[Generation]
"""Finished iterations, in order."""
UNCHANGED_BEST = 10
"""Table 5: iterations for which the best solution stays as it is."""
UNCHANGED_ALTERNATIVES = 5
"""Table 7: the number of alternative optima stays the same for more iterations than this."""


def converged_at(values: Sequence[float | None], unchanged: int) -> int | None:
    """Returns the iteration, counted from 1, of the last change in `values`, if at least `unchanged` iterations follow; else None.

    For instance, of 20 iterations with the best set in the 12th, only 8 follow: fewer than 10, so the search has not converged.
    """
    since = 0
    for index in range(1, len(values)):
        if not same(values[index], values[since]):
            since = index
    if not values or values[since] is None or len(values) - 1 - since < unchanged:
        return None
    return since + 1


def best_at(best: Sequence[float | None]) -> int | None:
    """Returns the iteration that found the best solution, if it then stayed for at least 10 iterations (Table 5)."""
    return converged_at(best, UNCHANGED_BEST)


def alternatives_at(best: Sequence[float | None], alternatives: Sequence[int]) -> int | None:
    """Returns the iteration after which the number of alternative optima stayed for more than 5 iterations (Table 7). A change of the best
    objective counts as a change of the number."""
    if not best or best[-1] is None:
        return None
    return converged_at(changes(best, alternatives), UNCHANGED_ALTERNATIVES + 1)


def last_change(values: Sequence[float | None]) -> int:
    """Returns the iteration, counted from 1, that changed `values` last; 1 if none did."""
    return next((index + 2 for index in range(len(values) - 2, -1, -1) if not same(values[index], values[-1])), 1)


def changes(best: Sequence[float | None], alternatives: Sequence[int]) -> list[float]:
    """Returns how often best objective or number of alternatives had changed by each iteration."""
    states = list(zip(best, alternatives, strict=True))
    changed = (before != after or not same(old, new) for ((old, before), (new, after)) in pairwise(states))
    return [float(count) for count in accumulate(changed, initial=0)] if states else []


def expected_gain(best: Sequence[float | None]) -> float | None:
    """Returns by how much a campaign with twice the budget, which begins with these results, would probably improve the best objective, at
    most: the largest gain of the last three doublings of the rounds. None without a best objective by their middle. The benchmark
    `economy --outlook` has the record."""
    last = len(best) - 1
    if last < 1 or best[last // 2] is None:
        return None
    doubled = [value for part in (8, 4, 2, 1) if (value := best[last // part]) is not None]
    return max(abs(after - before) for before, after in pairwise(doubled))


def improved_last(course: Course) -> bool:
    """Returns whether the last iteration improved the best objective."""
    if len(course) < 2:
        return False
    before, last = course[-2].best, course[-1].best
    return before is not None and last is not None and not same(before, last)


def stood_still(course: Course, best: float) -> bool:
    """Returns whether the best objective is still that of the first iteration. A rating that rose among equal objectives is no gain."""
    first, last = course[0].best, course[-1].best
    return first is not None and same(first, last) and same(first, best)

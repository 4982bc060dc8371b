"""Every printed interval holds as often as it claims, by simulation, and is hardly wider than the exact one.

The figures of docs/pages/concepts/predictions.md come from `python -m tests.unit.analysis.test_coverage`.
"""

import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from tests.support.values import present

from drivecal.analysis.front import non_dominated
from drivecal.analysis.importance import importances
from drivecal.analysis.replicates import assess, interval, rate_bounds
from drivecal.analysis.robustness import undetected_share
from drivecal.analysis.validation import mean_interval
from drivecal.reduction.lots import SamplingPlan, most_released, smallest_plan

REPEATS = 2_000
Row = tuple[float, float, float | None]
"""Share of the repeats whose interval held, its mean width, and the mean width of the exact interval, if known."""


def counts(share: float, size: int) -> Row:
    """R_err of audits and of released predictions: Clopper and Pearson, which is the exact one."""
    random = np.random.default_rng(1)
    ends = np.array([rate_bounds(int(wrong), size) for wrong in random.binomial(size, share, REPEATS)])
    width = float((ends[:, 1] - ends[:, 0]).mean())
    return float(((ends[:, 0] <= share) & (share <= ends[:, 1])).mean()), width, width


def means(share: float, size: int, variants: int) -> Row:
    """R_err of a validation: the mean over base sets of the share of wrong variants, which are alike or not within a base set."""
    random = np.random.default_rng(2)
    ends, exact = np.empty((REPEATS, 2)), np.empty((REPEATS, 2))
    for repeat in range(REPEATS):
        wrong = random.random(size) < share
        shares = wrong.astype(np.float64) if variants == 1 else random.binomial(variants, share, size) / variants
        ends[repeat] = mean_interval(shares)
        exact[repeat] = rate_bounds(int(wrong.sum()), size)
    held = (ends[:, 0] <= share) & (share <= ends[:, 1])
    known = float((exact[:, 1] - exact[:, 0]).mean()) if variants == 1 else None
    return float(held.mean()), float((ends[:, 1] - ends[:, 0]).mean()), known


def lots(wrong: int, number: int, plan: SamplingPlan) -> Row:
    """Largest share of errors that lots released, after every lot; the exact limit is that of all lots as one sample."""
    random = np.random.default_rng(3)
    held, limits = 0, []
    for _ in range(REPEATS):
        drawn = random.hypergeometric(wrong, plan.size - wrong, plan.sample, number)
        released = int(sum(wrong - errors for errors in drawn if plan.releases(int(errors))))
        limit = most_released([(plan, int(errors)) for errors in drawn])
        held += released <= limit + 1e-9
        limits.append(limit / (number * plan.size))
    return held / REPEATS, float(np.mean(limits)), None


def boxes(failing: float, samples: int, compared: int) -> Row:
    """Failing vehicles that a box without one may have: of the set that was chosen by its boxes, each with the same share of them."""
    random = np.random.default_rng(4)
    seen = random.binomial(samples, failing, (REPEATS, compared)).min(axis=1)
    claimed = seen == 0
    wrong = claimed & (failing > undetected_share(samples, compared))
    return 1.0 - float(wrong.mean()), undetected_share(samples, compared), undetected_share(samples, compared)


def importance(function: Callable[[Any], Any], effects: Sequence[float], size: int) -> Row:
    """Total effects of parameters that are drawn evenly from 0 to 1, as shares of the variation."""
    random, truths = np.random.default_rng(5), np.array(effects)
    held, widths = list[float](), list[float]()
    for _ in range(REPEATS // len(truths)):
        sets = random.uniform(size=(size, len(truths)))
        result = present(importances(sets, function(sets)))
        held.append(float(((result.lower <= truths) & (truths <= result.upper)).mean()))
        widths.append(float((result.upper - result.lower).mean()))
    return float(np.mean(held)), float(np.mean(widths)), None


def ishigami(sets: Any) -> Any:
    """Ishigami and Homma 1990, on 0 to 1. Of the variation 0.558, 0.442 and 0.244 are total effects of the first three parameters."""
    x, y, z = (np.pi * (2 * sets[:, place] - 1) for place in range(3))
    return np.sin(x) + 7 * np.sin(y) ** 2 + 0.1 * z**4 * np.sin(x)


def random_sets(common: float, *, part: str, rare: float = 0.0) -> Row:
    """Objectives of 20 sets of a random simulator: each under three seeds, five under nine more, the best one reported by eight others.

    What a seed does to all sets is `common` times as large as a set's own noise. A share of `rare` seeds makes all sets worse by fifty.
    """
    random, held, widths = np.random.default_rng(6), [], []
    for _ in range(REPEATS):
        truths, sets, known = random.normal(size=(2, 20)), [], []
        for truth in truths:
            drawn = truth[:, np.newaxis] + random.normal(size=(20, 20)) + common * random.normal(size=20)
            if rare:
                drawn -= 50 * ((random.random(20) < rare) - rare)
            few = np.argsort(drawn[:, :3].mean(axis=1))[:-5]
            sets.append(drawn.copy())
            drawn[few, 3:] = np.nan
            known.append(assess(drawn[:, :12]))
        first, places, halves = known[0], np.arange(20), known[0].half_widths(0.95)
        middles = np.where(first.counts > 3, sets[0][:, :12].mean(axis=1), sets[0][:, :3].mean(axis=1))
        if part == "best":
            places = np.array([first.best(0.95)])
            spread = float(first.spreads[places[0]]), min(float(first.spread_freedom[places[0]]), 11.0)
            lower, upper = interval(sets[0][places[0], 12:].tolist(), None, 0.95, *spread, first.skewness)
            middles, halves = np.full(20, ((upper or 0) + (lower or 0)) / 2), np.full(20, ((upper or 0) - (lower or 0)) / 2)
        elif part == "front":
            places, middles = np.flatnonzero(non_dominated(np.stack([each.means for each in known], axis=1))), first.means
        held += (np.abs(truths[0] - middles) <= halves)[places].tolist()
        widths += (2 * halves)[places].tolist()
    return float(np.mean(held)), float(np.mean(widths)), None


PLAN = smallest_plan(250, 0.05, 1)
RARE = "best of 20 random sets, 4 % of seeds make all sets worse by fifty"
"""Misses often: most campaigns do not meet such a seed."""
TABLE: dict[str, Callable[[], Row]] = {
    "wrong answers, 2 % of 200 (Clopper, Pearson)": lambda: counts(0.02, 200),
    "wrong answers, 30 % of 50": lambda: counts(0.3, 50),
    "R_err of a validation, 50 % of 200 base sets, one variant": lambda: means(0.5, 200, 1),
    "R_err of a validation, 2 % of 100 base sets, one variant": lambda: means(0.02, 100, 1),
    "R_err of a validation, 5 % of 60 base sets, 30 variants": lambda: means(0.05, 60, 30),
    "released errors, 8 lots of 250 with 12 wrong (at most)": lambda: lots(12, 8, PLAN),
    "released errors, 8 lots of 250 with 3 wrong (at most)": lambda: lots(3, 8, PLAN),
    "failing vehicles, 10 % in every box, 1 set (up to)": lambda: boxes(0.1, 30, 1),
    "failing vehicles, 10 % in every box, the best of 20 sets (up to)": lambda: boxes(0.1, 30, 20),
    "importance, 4 a + 2 b + c + d/2 of five parameters, 300 sets": lambda: importance(
        lambda sets: sets @ [4.0, 2.0, 1.0, 0.5, 0.0], [0.7529, 0.1882, 0.0471, 0.0118, 0], 300
    ),
    "importance, Ishigami's function of five parameters, 150 sets": lambda: importance(
        ishigami, [0.5576, 0.4424, 0.2437, 0, 0], 150
    ),
    "best of 20 random sets": lambda: random_sets(0.0, part="best"),
    "best of 20 random sets, seeds do ten times as much as their own noise": lambda: random_sets(10.0, part="best"),
    RARE: lambda: random_sets(0.0, part="best", rare=0.04),
    "all 20 of them": lambda: random_sets(10.0, part="all"),
    "sets of a front of two objectives": lambda: random_sets(0.0, part="front"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(TABLE.keys() - {RARE}))
def test_an_interval_holds_as_often_as_it_claims(name: str) -> None:
    held, width, exact = TABLE[name]()
    assert held >= 0.93
    assert exact is None or width <= 1.5 * exact


def test_the_limit_of_lots_without_an_error_is_near_the_exact_one() -> None:
    """Twelve lots of 90 without an error in their samples: an exact limit of all as one sample is 3.5 %."""
    plan = smallest_plan(90, 0.05, 0)
    assert most_released([(plan, 0)] * 12) / (12 * 90) < 1.5 * 0.035


if __name__ == "__main__":
    for title, compute in TABLE.items():
        share, mean, known = compute()
        sys.stdout.write(f"| {title} | {100 * share:.1f} % | {mean:.4f} | {'' if known is None else f'{known:.4f}'} |\n")

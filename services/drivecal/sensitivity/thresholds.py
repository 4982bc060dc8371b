"""Statistics of elementary effects (Morris 1991; Campolongo et al. 2007), and thresholds from which a parameter counts: on s_rel, on |mu|
and sigma, or derived (`auto`).

`auto` starts from the effect of a score with steps on s_rel. Take a tolerance of one step and a range of r steps. A change by the tolerance
between two runs is then an effect of 1/(r d) for a step d of the parameter, even if the rating behind it hardly moved. s_rel is about the
root mean square of the effects. So s_rel mainly counts changed runs: k such changes in n effects give about sqrt(k / (n - 1)) / (r d). In
an interval of a tenth of the range, that is ten times as much as in the whole range. With one number for both, either every change counts
in the interval or hardly any in the whole range. `auto` therefore fixes the number of tolerated changes, not s_rel:

* The paper accepts a change by the tolerance in a reused result (Equation 8), and calls a rate of 1.08 % negligible (Table 2). `auto`
  tolerates the least number of changes that n effects do not exceed, with a probability of at least 95 %, at a rate of 1 %: none up to
  n = 5, one up to n = 35, three at n = 100.
* The threshold lies halfway between this number and one more, for the steps that were made. A change by twice the tolerance weighs as
  four, more than is tolerated up to n = 137.

It depends on the design alone, not on the scores: it is known before the first run, and no result changes it.

A score without steps has no smallest change; in any scale, a change by the tolerance is an effect of tolerance / (span step). Simulations
are deterministic, so smaller changes are influence and no noise, but influence that no audit calls wrong. They add up by their squares:
changes by half the tolerance count a quarter each (decision 027).

This bounds false alarms: a parameter with a true rate of 1 % counts as influential with a probability of at most 5 %. It does not bound
misses: at a rate of 10 %, a parameter counts as non-influential with a probability of 0.51 at 16 samples, 0.39 at 20 and 0.01 at 100
(`miss_probability`). If misses cost more than runs, take more samples or a small number as the threshold.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import count
from math import nan, sqrt
from typing import Any, Literal

import numpy as np

from drivecal.contracts.specification import SeparateThresholds
from drivecal.domain.rounding import SHARE
from drivecal.domain.scales import COMFORT, Scale
from drivecal.plugins.ports import Floats


@dataclass(frozen=True, slots=True)
class EffectStatistics:
    """Statistics of r elementary effects of a parameter: mean, mean of magnitudes, standard deviation, and number.

    Fewer than two effects have no standard deviation: all figures are NaN then.
    """

    mu: float
    mu_star: float
    sigma: float
    n_effects: int

    @property
    def s_rel(self) -> float:
        """The relative sensitivity sqrt(mu^2 + sigma^2), which is about the root mean square of the effects."""
        return sqrt(self.mu**2 + self.sigma**2)


def measures(effects: Floats) -> EffectStatistics:
    """Returns the statistics of an analysis' effects, shape (r,); NaN effects of failed runs do not count."""
    known = effects[~np.isnan(effects)]
    if known.size < 2:
        return EffectStatistics(nan, nan, nan, known.size)
    mean, magnitude = float(known.mean()), float(np.abs(known).mean())
    return EffectStatistics(mean, magnitude, float(known.std(ddof=1)), known.size)


def smallest_nonzero(statistics: Sequence[EffectStatistics]) -> float | None:
    """The smallest s_rel that is not zero, None if all are: with few samples a threshold below it means any change at all."""
    return min((effect.s_rel for effect in statistics if effect.s_rel > 0), default=None)


TOLERATED_RATE = 0.01
"""Changes by the tolerance, per step, that count as negligible; the largest error ratio in Table 2 is 0.0108."""
CONFIDENCE = 0.95
SEEN_RATE = 0.1
"""The rate of changes for which the probability of a miss is reported: ten times what is tolerated."""
ROUNDING = 1 + 1e-9
"""Least ratio of sums of squares to proved bounds: their own rounding errors are far smaller."""


Threshold = float | SeparateThresholds | Literal["auto"]
"""A number is a threshold on s_rel."""


@cache
def tolerated_changes(n_effects: int) -> int:
    """The smallest m for which at most m changes in `n_effects` have a probability of `CONFIDENCE`, at `TOLERATED_RATE`."""
    from scipy.special import bdtr  # takes a while, which commands that only look things up need not pay

    most = min(n_effects, 10 + n_effects // 20)  # beyond the quantile, five times the expected number
    enough = bdtr(np.arange(most + 1.0), n_effects, TOLERATED_RATE) >= CONFIDENCE
    return int(np.argmax(enough))


def miss_probability(samples: int, change_rate: float) -> float:
    """The probability that `auto` calls a parameter non-influential that changes the score by its tolerance in `change_rate` of its steps.

    For one analysis of `samples` effects of equal steps. The lengths of real steps differ, which adds at most 0.07. Larger changes are
    missed less often.
    """
    from scipy.special import bdtr

    return float(bdtr(tolerated_changes(samples), samples, change_rate))


def tolerance_text(samples: int) -> str:
    """Returns a sentence about the influence that `auto` tolerates, how often it misses more, and how many samples miss half as often."""
    missed = miss_probability(samples, SEEN_RATE)
    more = next(n for n in count(samples + 1) if missed < 0.01 or 2 * miss_probability(n, SEEN_RATE) <= missed)
    return (
        f"threshold auto tolerates a change by the score's tolerance in {tolerated_changes(samples)} of {samples} effects: an "
        f"analysis misses a parameter that changes the score in {100 * SEEN_RATE:.0f} % of its steps with a probability of about "
        f"{100 * missed:.0f} %"
        + (f"; with {more} samples {100 * miss_probability(more, SEEN_RATE):.0f} %" if missed >= 0.01 else "")
    )


def automatic(steps: Floats, scale: Scale = COMFORT) -> float:
    """The threshold on s_rel for an analysis with these steps, shape (n,), n >= 2, in units of the full range."""
    mean_square = float(np.mean(_tolerated_effects(steps, scale) ** 2))
    return sqrt((tolerated_changes(steps.size) + 0.5) / (steps.size - 1) * mean_square)


def _tolerated_effects(steps: Floats, scale: Scale) -> Floats:
    """Effects of changes by the tolerance, shaped as `steps`."""
    effects: Floats = max(scale.tolerance, SHARE * scale.span) / (scale.span * steps)
    return effects


@dataclass(frozen=True, slots=True)
class Verdict:
    """Statistics of a parameter in a box, and whether it is influential.

    `threshold` is what was applied: on s_rel, or on |mu| and sigma; None if there was nothing to apply it to.
    """

    measures: EffectStatistics
    threshold: float | SeparateThresholds | None
    influential: bool


def verdict(statistics: EffectStatistics, steps: Floats, threshold: Threshold, scale: Scale = COMFORT) -> Verdict:
    """Applies a threshold to measures. `steps` belong to the effects that count, shape (n_effects,).

    With fewer than two effects, the parameter counts as influential.
    """
    if statistics.n_effects < 2:
        return Verdict(statistics, None, influential=True)
    if isinstance(threshold, SeparateThresholds):
        return Verdict(statistics, threshold, abs(statistics.mu) >= threshold.mu or statistics.sigma >= threshold.sigma)
    limit = automatic(steps, scale) if threshold == "auto" else float(threshold)
    return Verdict(statistics, limit, statistics.s_rel >= limit)


def is_surely_influential(
    effects: Floats, steps: Floats, missing: Floats, threshold: Threshold, scale: Scale = COMFORT
) -> bool:
    """Returns whether an analysis is influential for all possible values and failures of its missing effects.

    `effects` and `steps` belong to the finished runs, shape (n,); failed runs have NaN effects. `missing` has the steps of the other runs.

    With S the sum of squares of n effects, s_rel^2 = (S - mean^2) / (n - 1), and mean^2 <= S / n, so s_rel^2 >= S / n. S only grows. A
    number is certainly reached if S >= n threshold^2 for the largest possible n. `auto` is reached if (1 - 1/n) S >= (m + 1/2) mean(e^2)
    for every possible n and the shortest missing steps; e are the effects of changes by the tolerance. Squared deviations from the mean
    only grow as well, which settles a threshold on sigma; mu may still return to 0.
    """
    failed = np.isnan(effects)
    known, steps = effects[~failed], steps[~failed]
    if known.size < 2:
        return False
    most = known.size + missing.size
    squares = float(np.sum(known**2)) / ROUNDING
    if isinstance(threshold, SeparateThresholds):
        deviations = float(np.sum((known - known.mean()) ** 2)) / ROUNDING
        return bool(deviations >= (most - 1) * threshold.sigma**2)
    if threshold != "auto":
        return bool(squares >= most * float(threshold) ** 2)
    shortest = np.sort(np.abs(missing))
    weights = _tolerated_effects(np.concatenate([steps, shortest]), scale) ** 2
    n = np.arange(known.size, most + 1)
    tolerated = np.array([tolerated_changes(int(count)) for count in n])
    limits = (tolerated + 0.5) * np.cumsum(weights)[known.size - 1 :] / n
    return bool(np.all((1 - 1 / n) * squares >= limits))


def caveats(stored: Mapping[str, Any]) -> list[str]:
    """Returns what a map cannot show because of the settings that are stored with it, for readers: a line each, none for most settings."""
    lines = [tolerance_text(stored["samples"])] if stored["threshold"] == "auto" else []
    if stored.get("sequential") and stored["design"] == "lines":
        lines.append("sequential analysis: intervals between influential ones took no runs, so a larger s_rel may hide there")
    return lines

"""Rectifying inspection of predicted answers (Dodge and Romig 1959): lots, their samples, and the bound on released errors. Pure.

A lot of n predictions is committed first. Then m of them are drawn by a secret and simulated. If more than c differ, the whole lot is
simulated; otherwise the rest is released. For D wrong predictions in the lot, k of them in the sample, the expected share of released
errors is sum_{k <= c} P(k | D) (D - k) / n. Its maximum over D, the average outgoing quality limit (AOQL), bounds it for every
predictor and every drift, because chance comes from the sample alone. Expected errors of several lots add up without a correction.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.stats import betabinom, hypergeom

Floats = npt.NDArray[np.float64]

MOST_ACCEPTED = 5
"""Largest acceptance number that `best_plan` tries."""
DISPERSION = 50.0
"""Equivalent observations behind an expected error rate: lots of the same expectation differ by more than chance."""


@dataclass(frozen=True, slots=True)
class SamplingPlan:
    """Inspection of a lot of `size`: simulate `sample` of it, and the rest too if more than `acceptance` differ."""

    size: int
    sample: int
    acceptance: int

    def releases(self, errors: int) -> bool:
        """Whether a lot with so many errors in its sample is released."""
        return errors <= self.acceptance

    def expected_saving(self, error_rate: float) -> float:
        """Returns the expected number of released cells for an expected share of wrong predictions."""
        spare = self.size - self.sample
        if spare == 0:
            return 0.0
        wrong = min(max(error_rate, 1e-9), 1.0 - 1e-9) * DISPERSION
        released = betabinom.cdf(self.acceptance, self.sample, wrong, DISPERSION - wrong)
        return spare * float(released)


def outgoing_errors(plan: SamplingPlan) -> Floats:
    """Returns the expected share of released errors for D = 0..size wrong predictions, shape (size + 1,)."""
    wrong = np.arange(plan.size + 1)
    shares = np.zeros(plan.size + 1)
    for drawn in range(plan.acceptance + 1):
        shares += hypergeom.pmf(drawn, plan.size, wrong, plan.sample) * np.maximum(wrong - drawn, 0)
    return shares / max(plan.size, 1)


@lru_cache(maxsize=4096)
def smallest_plan(size: int, limit: float, acceptance: int) -> SamplingPlan:
    """Returns the plan with the smallest sample whose AOQL is at most `limit`; the sample may be the whole lot.

    Raises ValueError if `limit` is not between 0 and 1.
    """
    if not 0.0 < limit < 1.0:
        raise ValueError(f"the limit of released errors must lie between 0 and 1, not {limit}")
    few, enough = 0, size  # a whole lot in the sample releases no error
    while enough - few > 1:
        middle = (few + enough) // 2
        if outgoing_errors(SamplingPlan(size, middle, acceptance)).max() <= limit:
            enough = middle
        else:
            few = middle
    return SamplingPlan(size, enough, acceptance)


def best_plan(size: int, limit: float, error_rate: float) -> SamplingPlan:
    """Returns the plan of an AOQL of at most `limit` with the largest expected saving at an expected share of wrong predictions."""
    plans = [smallest_plan(size, limit, acceptance) for acceptance in range(MOST_ACCEPTED + 1)]
    return max(plans, key=lambda plan: (plan.expected_saving(error_rate), -plan.sample))


def draw(members: Sequence[bytes], sample: int, secret: bytes) -> list[int]:
    """Returns the positions of the sample, ascending, by a keyed hash of each member: fixed by `secret`, unknown without it.

    Draw only after the predictions are committed. Raises ValueError if a member occurs twice or the sample exceeds the lot.
    """
    if len(set(members)) < len(members) or sample > len(members):
        raise ValueError(f"cannot draw {sample} of {len(members)} members; members must be distinct")
    ranks = [hashlib.blake2b(member, key=secret, digest_size=16).digest() for member in members]
    return sorted(sorted(range(len(members)), key=ranks.__getitem__)[:sample])

"""Rectifying inspection of predicted answers (Dodge and Romig 1959): lots, their samples, and the bound on released errors. Pure.

A lot of n predictions is committed first. Then m of them are drawn by a secret and simulated. If more than c differ, the whole lot is
simulated; otherwise the rest is released. For D wrong predictions in the lot, k of them in the sample, the expected share of released
errors is sum_{k <= c} P(k | D) (D - k) / n. Its maximum over D, the average outgoing quality limit (AOQL), bounds it for every
predictor and every drift, because chance comes from the sample alone. Expected errors of several lots add up without a correction.
"""

import hashlib
import math
from bisect import bisect_left
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Positions = npt.NDArray[np.int64]

MOST_ACCEPTED = 5
"""Largest acceptance number that `best_plan` tries."""
COARSEST, FINER = 64, 16
"""Number of stretches of a lot's numbers of errors in the first look at an AOQL, and of parts of each in every further look."""
ROUNDING = 1e-7
"""Largest error of rounding in shares of released errors, for lots of a million."""
DISPERSION = 50.0
"""Equivalent observations behind an expected error rate: lots of the same expectation differ by more than chance."""


GROWTH = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
"""Growth rates that share half of the mixture behind `most_released`. The largest rate that the first plan permits has the other half."""
FASTEST = 3.0
"""Largest growth rate that is tried."""
MOST_PER_ERROR = 60.0
"""Largest evidence that one error in a sample may take back, as a logarithm."""


@dataclass(frozen=True, slots=True)
class SamplingPlan:
    """Inspection of a lot of `size`: simulate `sample` of it, and the rest too if more than `acceptance` differ."""

    size: int
    sample: int
    acceptance: int

    def releases(self, errors: int) -> bool:
        """Returns whether a lot with this number of errors in its sample is released."""
        return errors <= self.acceptance

    def expected_saving(self, error_rate: float) -> float:
        """Returns the expected number of released cells for an expected share of wrong predictions."""
        from scipy.special import betaln  # takes a while, which processes that inspect no lot need not pay

        spare = self.size - self.sample
        if spare == 0:
            return 0.0
        wrong = min(max(error_rate, 1e-9), 1.0 - 1e-9) * DISPERSION
        drawn = np.arange(min(self.acceptance, self.sample) + 1)
        chances = _log_choose(self.sample, drawn) + betaln(wrong + drawn, DISPERSION - wrong + self.sample - drawn)
        return spare * min(1.0, float(np.exp(chances - betaln(wrong, DISPERSION - wrong)).sum()))  # a beta-binomial


def outgoing_errors(plan: SamplingPlan, wrong: Positions | None = None) -> Floats:
    """Returns the expected share of released errors for numbers of wrong predictions, by default D = 0..size; shape as theirs."""
    numbers = np.arange(plan.size + 1) if wrong is None else wrong
    drawn = np.arange(plan.acceptance + 1)[:, None]
    errors: Floats = (_chances(plan, drawn, numbers[None, :]) * np.maximum(numbers[None, :] - drawn, 0)).sum(axis=0)
    return errors / max(plan.size, 1)


def _keeps(plan: SamplingPlan, limit: float) -> bool:
    """Returns whether all `outgoing_errors` stay within `limit`, without computing most of them.

    One more wrong prediction releases at most one more error, so the share grows by at most d / size over d numbers. Stretches that stay
    below the limit by this bound are skipped, others are divided.
    """
    step = max(1, plan.size // COARSEST)
    wrong = np.arange(0, plan.size + 1, step)
    while True:
        errors = outgoing_errors(plan, wrong)
        if errors.max() > limit:
            return False
        near = wrong[errors + (step - 1) / plan.size > limit - ROUNDING]
        if step == 1 or not len(near):
            return True
        finer = max(1, step // FINER)
        between = (near[:, None] + np.arange(finer, step, finer)[None, :]).ravel()
        wrong, step = np.concatenate([near, between[between <= plan.size]]), finer


def _chances(plan: SamplingPlan, drawn: Positions, wrong: Positions) -> Floats:
    """Returns the hypergeometric chances of `drawn` errors in the sample, for numbers of `wrong` predictions in the lot."""
    right = plan.size - wrong
    possible = (drawn <= wrong) & (plan.sample - drawn <= right) & (drawn <= plan.sample)
    logarithms = (
        _log_choose(wrong, np.minimum(drawn, wrong))
        + _log_choose(right, np.clip(plan.sample - drawn, 0, right))
        - _log_choose(plan.size, plan.sample)
    )
    return np.where(possible, np.exp(np.where(possible, logarithms, 0.0)), 0.0)


def _log_choose(count: Positions | int, chosen: Positions | int) -> Floats:
    from scipy.special import gammaln

    logarithms: Floats = gammaln(np.add(count, 1)) - gammaln(np.add(chosen, 1)) - gammaln(np.subtract(count, chosen) + 1)
    return logarithms


@lru_cache(maxsize=4096)
def smallest_plan(size: int, limit: float, acceptance: int) -> SamplingPlan:
    """Returns the plan with the smallest sample whose AOQL is at most `limit`; the sample may be the whole lot.

    Raises ValueError if `limit` is not between 0 and 1.
    """
    if not 0.0 < limit < 1.0:
        raise ValueError(f"the limit of released errors must lie between 0 and 1, not {limit}")
    few = smallest_plan(size, limit, acceptance - 1).sample - 1 if acceptance else 0  # too few for fewer errors already
    step = 8
    while few + step < size and not _keeps(SamplingPlan(size, few + step, acceptance), limit):
        few, step = few + step, 2 * step
    samples = range(few + 1, min(few + step, size))  # a whole lot in the sample releases no error
    place = bisect_left(samples, x=True, key=lambda sample: _keeps(SamplingPlan(size, sample, acceptance), limit))
    return SamplingPlan(size, few + 1 + place, acceptance)


def best_plan(size: int, limit: float, error_rate: float) -> SamplingPlan:
    """Returns the plan of an AOQL of at most `limit` with the largest expected saving at an expected share of wrong predictions."""
    best = smallest_plan(size, limit, 0)
    saving = best.expected_saving(error_rate)
    for acceptance in range(1, MOST_ACCEPTED + 1):
        plan = smallest_plan(size, limit, acceptance)
        if plan.size - plan.sample <= saving:  # samples grow with the acceptance number
            break
        if (expected := plan.expected_saving(error_rate)) > saving:
            best, saving = plan, expected
    return best


def draw(members: Sequence[bytes], sample: int, secret: bytes) -> list[int]:
    """Returns the positions of the sample, ascending, by a keyed hash of each member: fixed by `secret`, unknown without it.

    Draw only after the predictions are committed. Raises ValueError if a member occurs twice or the sample exceeds the lot.
    """
    if len(set(members)) < len(members) or sample > len(members):
        raise ValueError(f"cannot draw {sample} of {len(members)} members; members must be distinct")
    ranks = [hashlib.blake2b(member, key=secret, digest_size=16).digest() for member in members]
    return sorted(sorted(range(len(members)), key=ranks.__getitem__)[:sample])


def most_released(lots: Iterable[tuple[SamplingPlan, int]]) -> float:
    """Returns an upper limit of the number of errors released by inspected lots, each with the errors in its sample.

    Time-uniform: with probability 0.95 it holds after every lot at once, for every number of errors in each of them, which may depend on
    all earlier samples. Per lot, exp(g E - h(g) k) has an expectation of at most 1 over the draw without replacement, with E released
    errors (none if the lot is rejected) and k sampled ones, counted up to c + 1. The product over lots is a supermartingale, a mixture over
    growth rates g as well (Waudby-Smith and Ramdas 2020 build theirs in this way), and Ville's inequality bounds it. The first plan, which
    is known before any sample, decides the fastest rate.
    """
    from scipy.optimize import brentq

    inspected = list(lots)
    offsets: list[tuple[float, float]] = []
    shares = dict.fromkeys(GROWTH, 0.5 / len(GROWTH))
    if inspected:
        fastest = fastest_growth(inspected[0][0])
        shares[fastest] = shares.get(fastest, 0.0) + 0.5
    for growth, share in shares.items():
        costs = [cost_of_an_error(plan, growth) for plan, _ in inspected]
        if all(math.isfinite(cost) for cost in costs):
            paid = sum(cost * min(errors, plan.acceptance + 1) for cost, (plan, errors) in zip(costs, inspected, strict=True))
            offsets.append((growth, math.log(share) - paid))
    unknown = sum(plan.size - plan.sample for plan, errors in inspected if plan.releases(errors))
    evidence = math.log(1.0 / (1.0 - 0.95))

    def excess(released: float) -> float:
        exponents = np.array([growth * released + offset for growth, offset in offsets])
        return float(np.logaddexp.reduce(exponents)) - evidence

    if not offsets or excess(float(unknown)) <= 0.0:
        return float(unknown)
    return float(brentq(excess, 0.0, float(unknown)))


@lru_cache(maxsize=4096)
def fastest_growth(plan: SamplingPlan) -> float:
    """Returns the largest growth rate, to a hundredth of it, for which `cost_of_an_error` is finite; a very small one if none is."""
    permitted, refused = min(GROWTH[-1], 1.0 / plan.size), FASTEST
    while refused > 1.01 * permitted:
        middle = math.sqrt(permitted * refused)
        permitted, refused = (middle, refused) if math.isfinite(cost_of_an_error(plan, middle)) else (permitted, middle)
    return permitted


@lru_cache(maxsize=4096)
def cost_of_an_error(plan: SamplingPlan, growth: float) -> float:
    """Returns the smallest h for `most_released`: the evidence against released errors that an error in the sample takes back; infinite if
    none suffices."""
    from scipy.optimize import brentq

    wrong = np.arange(plan.size + 1)[None, :]
    drawn = np.arange(min(plan.acceptance, plan.sample) + 1)[:, None]
    chances = _chances(plan, drawn, wrong)
    gain = chances * np.exp(np.minimum(growth * np.maximum(wrong - drawn, 0), 700.0))
    rejected = np.maximum(1.0 - chances.sum(axis=0), 0.0)

    def expected(cost: float) -> float:
        released = (gain * np.exp(-cost * drawn)).sum(axis=0)
        return float((released + rejected * math.exp(-cost * (plan.acceptance + 1))).max()) - 1.0

    if expected(MOST_PER_ERROR) > 1e-9:
        return math.inf
    return 0.0 if expected(0.0) <= 1e-9 else float(brentq(lambda cost: expected(cost) - 1e-9, 0.0, MOST_PER_ERROR))

"""The self-check of reuse: a share of reused cells is simulated all the same, and wrong answers are counted per scenario. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from scipy.special import betaincinv

from drivecal.contracts.campaign import ErrorRate

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Audit:
    """One audited cell: the score of the donor that was not trusted and the simulated one."""

    scenario: str
    expected: int
    simulated: int


def clopper_pearson(wrong: int, audited: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """The exact two-sided confidence interval of a proportion (Clopper, Pearson 1934). (0, 1) where nothing was audited."""
    tail = (1 - confidence) / 2
    lower = 0.0 if wrong == 0 else float(betaincinv(wrong, audited - wrong + 1, tail))
    upper = 1.0 if wrong == audited else float(betaincinv(wrong + 1, audited - wrong, 1 - tail))
    return lower, upper


def count_audits(rates: Mapping[str, ErrorRate], audits: Iterable[Audit], max_error: float) -> dict[str, ErrorRate]:
    """The error rates with new audits counted in.

    `different`: any change of the score; `wrong`: a change by more than 1 (Eq. 8). Reuse in a scenario is stopped, for good, once
    the lower end of the interval passes `max_error`.
    """
    counted = dict(rates)
    for audit in audits:
        rate = counted.get(audit.scenario, ErrorRate())
        change = abs(audit.simulated - audit.expected)
        counted[audit.scenario] = rate.model_copy(
            update={
                "audited": rate.audited + 1,
                "different": rate.different + (change > 0),
                "wrong": rate.wrong + (change > 1),
            }
        )
    for scenario, rate in counted.items():
        if rate.audited:
            lower, upper = clopper_pearson(rate.wrong, rate.audited)
            counted[scenario] = rate.model_copy(update={"upper_95": upper, "stopped": rate.stopped or lower > max_error})
    return counted

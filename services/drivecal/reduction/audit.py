"""Audits: chooses reused cells to simulate as checks and cells to run twice, and computes the error rates of reuse. Pure."""

import hashlib
from collections.abc import Iterable, Mapping

from drivecal.contracts.campaign import ErrorRate
from drivecal.domain.evaluations import AuditCount
from drivecal.domain.parameters import ParameterSet

CONFIDENCE = 0.95
PRIOR_WRONG, PRIOR_AUDITS = 0.25, 50.0
"""Wrong answers and audits that count before the first one: half a percent, the order of the paper's R_err."""


def is_audited(scenario: str, parameters: ParameterSet, share: float, seed: int) -> bool:
    """Returns whether a reusable cell is simulated as an audit: a hash of seed, scenario and parameter set decides."""
    return _drawn(f"{seed}:{scenario}:".encode() + parameters.key, share)


def is_checked(scenario: str, parameters: ParameterSet, share: float, campaign: int) -> bool:
    """Returns whether a cell runs twice, as a test that its simulator is deterministic: a hash of campaign, scenario and set decides."""
    return _drawn(f"twice:{campaign}:{scenario}:".encode() + parameters.key, share)


def _drawn(content: bytes, share: float) -> bool:
    draw = int.from_bytes(hashlib.blake2b(content, digest_size=8).digest(), "big")
    return draw < share * 2**64


def clopper_pearson(wrong: int, audited: int) -> tuple[float, float]:
    """Returns the exact two-sided 95 % interval of a proportion (Clopper, Pearson 1934); (0, 1) without audits."""
    from scipy.special import betaincinv  # takes a while, which commands that only look things up need not pay

    tail = (1 - CONFIDENCE) / 2  # closed form: scipy's binomtest searches the same limits to 1e-11
    lower = 0.0 if wrong == 0 else float(betaincinv(wrong, audited - wrong + 1, tail))
    upper = 1.0 if wrong == audited else float(betaincinv(wrong + 1, audited - wrong, 1 - tail))
    return lower, upper


def expected_error_rate(rate: ErrorRate | None) -> float:
    """Returns the expected share of wrong references, by the audits so far and a weak belief in the map."""
    wrong, audited = (0, 0) if rate is None else (rate.wrong, rate.audited)
    return (wrong + PRIOR_WRONG) / (audited + PRIOR_AUDITS)


def error_rates(
    counts: Iterable[AuditCount],
    scenarios: Iterable[str],
    contradictions: Mapping[str, int] | None = None,
    lots: Mapping[str, tuple[int, int]] | None = None,
    released: Mapping[str, float] | None = None,
) -> dict[str, ErrorRate]:
    """Returns the error rate of each scenario (Eq. 8: wrong / audited), with `contradictions` and inspected and rejected `lots`.

    `released` has upper limits of the share of wrong answers that lots released. Lots are sampled in different shares, so only audits
    without lots have a Clopper-Pearson interval."""
    by_scenario = {count.scenario: count for count in counts}
    rates: dict[str, ErrorRate] = {}
    for scenario in scenarios:
        inspected, rejected = (lots or {}).get(scenario, (0, 0))
        rate = ErrorRate(contradictions=(contradictions or {}).get(scenario, 0), lots=inspected, rejected=rejected)
        count = by_scenario.get(scenario)
        if count is not None and count.audited:
            upper = (released or {}).get(scenario) if inspected else clopper_pearson(count.wrong, count.audited)[1]
            counted = {"audited": count.audited, "different": count.different, "wrong": count.wrong, "upper_95": upper}
            rate = rate.model_copy(update=counted)
        rates[scenario] = rate
    return rates

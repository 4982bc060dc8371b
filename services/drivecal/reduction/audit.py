"""Audits: the choice of reused and certified cells that are simulated all the same, and the error rates of reuse. Pure."""

import hashlib
from collections.abc import Iterable, Mapping

from drivecal.contracts.campaign import ErrorRate
from drivecal.domain.evaluations import AuditCount
from drivecal.domain.parameters import ParameterSet

CONFIDENCE = 0.95


def is_audited(scenario: str, parameters: ParameterSet, share: float, seed: int) -> bool:
    """Whether a reusable cell is simulated all the same: by a hash of seed, scenario and parameter set."""
    return _drawn(f"{seed}:{scenario}:".encode() + parameters.key, share)


def is_checked(scenario: str, parameters: ParameterSet, share: float, campaign: int) -> bool:
    """Whether a certified cell is simulated all the same: by a hash of the campaign's number, scenario and parameter set."""
    return _drawn(f"certificate:{campaign}:{scenario}:".encode() + parameters.key, share)


def _drawn(content: bytes, share: float) -> bool:
    draw = int.from_bytes(hashlib.blake2b(content, digest_size=8).digest(), "big")
    return draw < share * 2**64


def clopper_pearson(wrong: int, audited: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Returns the exact two-sided confidence interval of a proportion (Clopper, Pearson 1934); (0, 1) without audits."""
    from scipy.special import betaincinv  # takes a while, which commands that only look things up need not pay

    tail = (1 - confidence) / 2  # closed form: scipy's binomtest searches the same limits to 1e-11
    lower = 0.0 if wrong == 0 else float(betaincinv(wrong, audited - wrong + 1, tail))
    upper = 1.0 if wrong == audited else float(betaincinv(wrong + 1, audited - wrong, 1 - tail))
    return lower, upper


def error_rates(
    counts: Iterable[AuditCount],
    before: Mapping[str, ErrorRate],
    scenarios: Iterable[str],
    max_error: float,
    contradictions: Mapping[str, int] | None = None,
) -> dict[str, ErrorRate]:
    """The error rate of each scenario (Eq. 8: wrong / audited), with its `contradictions` beside it.

    Reuse in a scenario is stopped once the lower end of the interval passes `max_error`, and stays stopped (`before`).
    """
    by_scenario = {count.scenario: count for count in counts}
    rates: dict[str, ErrorRate] = {}
    for scenario in scenarios:
        was_stopped = scenario in before and before[scenario].stopped
        contradicting = (contradictions or {}).get(scenario, 0)
        count = by_scenario.get(scenario)
        if count is None or count.audited == 0:
            rates[scenario] = ErrorRate(stopped=was_stopped, contradictions=contradicting)
            continue
        lower, upper = clopper_pearson(count.wrong, count.audited)
        rates[scenario] = ErrorRate(
            audited=count.audited,
            different=count.different,
            wrong=count.wrong,
            upper_95=upper,
            stopped=was_stopped or lower > max_error,
            contradictions=contradicting,
        )
    return rates


def stopped_after(counts: Iterable[tuple[int, AuditCount]], max_error: float) -> tuple[int, AuditCount] | None:
    """The iteration at whose end reuse in a scenario was stopped, and the audits until then; None if it never was.

    `counts`: of each iteration alone, in order.
    """
    audited = different = wrong = 0
    for iteration, count in counts:
        audited, different, wrong = audited + count.audited, different + count.different, wrong + count.wrong
        if audited and clopper_pearson(wrong, audited)[0] > max_error:
            return iteration, AuditCount(count.scenario, audited, different, wrong)
    return None

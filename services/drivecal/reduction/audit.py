"""Audits: chooses reused cells to simulate as checks and cells to run twice. Pure."""

import hashlib

from drivecal.contracts.campaign import ErrorRate
from drivecal.domain.parameters import ParameterSet

PRIOR_WRONG, PRIOR_AUDITS = 0.25, 50.0
"""Wrong answers and audits that count before the first one: half a percent, the order of the paper's R_err."""


def is_audited(scenario: str, parameters: ParameterSet, share: float, seed: int) -> bool:
    """Returns whether a reusable cell is simulated as an audit: a hash of seed, scenario and parameter set decides."""
    return _drawn(f"{seed}:{scenario}:".encode() + parameters.key, share)


def is_checked(scenario: str, seed: int, parameters: ParameterSet, share: float, campaign: int) -> bool:
    """Returns whether a cell runs twice, as a test that it repeats: a hash of campaign, scenario, seed and set decides."""
    return _drawn(f"twice:{campaign}:{scenario}:{seed}:".encode() + parameters.key, share)


def _drawn(content: bytes, share: float) -> bool:
    draw = int.from_bytes(hashlib.blake2b(content, digest_size=8).digest(), "big")
    return draw < share * 2**64


def expected_error_rate(rate: ErrorRate | None) -> float:
    """Returns the expected share of wrong references, by the audits so far and a weak belief in the map."""
    wrong, audited = (0, 0) if rate is None else (rate.wrong, rate.audited)
    return (wrong + PRIOR_WRONG) / (audited + PRIOR_AUDITS)

"""Decides how every requested cell of a population is answered, before any simulation.

Order of answers: repeated, reused, (predicted,) simulated. The decision depends on the population, on what was stored and on
the seed alone, never on the workers' timing, so that it can be committed, resumed and repeated.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace

from drivecal.contracts.campaign import ErrorRate
from drivecal.contracts.specification import ReductionSpecification
from drivecal.domain.evaluations import Donor, Outcome, Purpose, RequestedCell
from drivecal.domain.parameters import ParameterSet

PRIOR_WRONG, PRIOR_AUDITS = 0.25, 50.0
"""Wrong answers and audits that count before the first one: half a percent, the order of the paper's R_err."""


def is_audited(scenario: str, parameters: ParameterSet, share: float, seed: int) -> bool:
    """Returns whether a reusable cell is simulated as an audit: a hash of seed, scenario and parameter set decides."""
    return _drawn(f"{seed}:{scenario}:".encode() + parameters.key, share)


def is_checked(scenario: str, seed: int, parameters: ParameterSet, share: float, search_seed: int) -> bool:
    """Returns whether a cell runs twice, as a test that it repeats: a hash of the search's seed, scenario, seed and set decides."""
    return _drawn(f"twice:{search_seed}:{scenario}:{seed}:".encode() + parameters.key, share)


def _drawn(content: bytes, share: float) -> bool:
    draw = int.from_bytes(hashlib.blake2b(content, digest_size=8).digest(), "big")
    return draw < share * 2**64


def expected_error_rate(rate: ErrorRate | None) -> float:
    """Returns the expected share of wrong references, by the audits so far and a weak belief in the map."""
    wrong, audited = (0, 0) if rate is None else (rate.wrong, rate.audited)
    return (wrong + PRIOR_WRONG) / (audited + PRIOR_AUDITS)


LIKELY = 0.25
"""Share of the cells ahead that predictions or a map are expected to answer if they have answered nothing yet."""


def assign(
    cells: Sequence[RequestedCell],
    policy: ReductionSpecification,
    seed: int,
    exact: Mapping[tuple[str, ParameterSet], Donor],
    references: Mapping[tuple[str, bytes], Donor],
    elsewhere: Mapping[tuple[str, ParameterSet], Donor] | None = None,
) -> list[RequestedCell]:
    """Returns the cells with their plans, in order. The `policy` says what may answer them, and with the `seed` which reused cells are
    simulated as audits.

    `exact` holds stored results by (scenario, parameter set), `references` by (scenario, reference key); `elsewhere` the references that
    answered these cells in an equal campaign, after their inspection: they come first, so that the same campaign again is the same.
    """
    if policy.mode == "off":
        return list(cells)
    same_set: dict[tuple[str, ParameterSet], int] = {}
    same_class: dict[tuple[str, bytes], int] = {}
    planned: list[RequestedCell] = []
    for position, cell in enumerate(cells):
        identity = (cell.scenario, cell.parameters)
        if elsewhere and identity in elsewhere:
            planned.append(replace(cell, plan=Outcome.REUSED, donor=elsewhere[identity], from_equal_campaign=True))
            continue
        if identity in exact or identity in same_set:
            donor, leader = exact.get(identity), same_set.get(identity)
            planned.append(replace(cell, plan=Outcome.REPEATED, donor=donor, leader=None if donor is not None else leader))
            continue
        donor = leader = None
        if policy.uses_map and cell.reference_key is not None:
            kind = (cell.scenario, cell.reference_key)
            donor = None if cell.purpose is Purpose.START else references.get(kind)
            leader = None if cell.purpose is Purpose.START or donor is not None else same_class.get(kind)
            if donor is None and leader is None:
                same_class[kind] = position
        has_donor = donor is not None or leader is not None
        inspected = has_donor and is_audited(cell.scenario, cell.parameters, policy.audit, seed)
        plan = Outcome.REUSED if has_donor and not inspected else Outcome.SIMULATED
        if plan is Outcome.SIMULATED:
            same_set[identity] = position
        cell = replace(cell, purpose=Purpose.AUDIT) if inspected else cell
        planned.append(replace(cell, plan=plan, donor=donor, leader=leader))
    return planned

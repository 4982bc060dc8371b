"""Decides how every requested cell of a population is answered, before any simulation.

Order of answers: repeated, reused, (predicted,) simulated. The decision depends on the population, on what was stored and on
the seed alone, never on the workers' timing, so that it can be committed, resumed and repeated.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from drivecal.contracts.specification import ReductionSpecification
from drivecal.domain.evaluations import Donor, Outcome, Purpose, RequestedCell
from drivecal.domain.parameters import ParameterSet
from drivecal.reduction.audit import is_audited

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

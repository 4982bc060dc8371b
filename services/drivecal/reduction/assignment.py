"""Decides how every requested cell of a population is answered, before any simulation.

Order of answers: repeated, reused, (predicted, certified,) simulated. The decision depends on the population, on what was stored and on
the seed alone, never on the workers' timing, so that it can be committed, resumed and repeated.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drivecal.contracts.specification import ReductionMode
from drivecal.domain.evaluations import Donor, Outcome
from drivecal.domain.parameters import ParameterSet
from drivecal.reduction.audit import is_audited


@dataclass(frozen=True, slots=True)
class RequestedCell:
    """A cell that a stage asks for. `individual` numbers the parameter sets of an iteration; `reference_key` is None without an influence
    map. `is_given`: of the baseline or a start set, whose score no reference answers, for others are compared with it."""

    individual: int
    scenario: str
    parameters: ParameterSet
    reference_key: bytes | None = None
    is_given: bool = False


@dataclass(frozen=True, slots=True)
class Assignment:
    """The answer of a cell.

    `donor`: the stored result that is copied (repeated, reused) or that an audit does not trust (`audited`). `leader`: the position of
    the cell of the same population whose simulation answers this one, or that an audit does not trust.
    """

    plan: Outcome
    donor: Donor | None = None
    leader: int | None = None
    audited: bool = False


@dataclass(frozen=True, slots=True)
class Policy:
    """Allowed answers. `audit`: share of reused cells that are simulated as audits."""

    mode: ReductionMode
    audit: float = 0.0
    seed: int = 0

    @property
    def reuses(self) -> bool:
        """Whether references may answer cells."""
        return self.mode in {"influence", "both"}

    @property
    def predicts(self) -> bool:
        """Whether predictions may answer cells."""
        return self.mode in {"predicted", "both"}


def assign(
    cells: Sequence[RequestedCell],
    policy: Policy,
    exact: Mapping[tuple[str, ParameterSet], Donor],
    references: Mapping[tuple[str, bytes], Donor],
) -> list[Assignment]:
    """Returns the assignment of each cell, in order.

    `exact` holds stored results by (scenario, parameter set), `references` by (scenario, reference key).
    """
    if policy.mode == "off":
        return [Assignment(Outcome.SIMULATED) for _ in cells]
    same_set: dict[tuple[str, ParameterSet], int] = {}
    same_class: dict[tuple[str, bytes], int] = {}
    assignments: list[Assignment] = []
    for position, cell in enumerate(cells):
        identity = (cell.scenario, cell.parameters)
        if identity in exact:
            assignments.append(Assignment(Outcome.REPEATED, donor=exact[identity]))
            continue
        if identity in same_set:
            assignments.append(Assignment(Outcome.REPEATED, leader=same_set[identity]))
            continue
        donor = leader = None
        reusable = policy.reuses and cell.reference_key is not None
        if reusable and cell.reference_key is not None:
            kind = (cell.scenario, cell.reference_key)
            donor = None if cell.is_given else references.get(kind)
            leader = None if cell.is_given or donor is not None else same_class.get(kind)
            if donor is None and leader is None:
                same_class[kind] = position
        if donor is None and leader is None:
            same_set[identity] = position
            assignments.append(Assignment(Outcome.SIMULATED))
        elif is_audited(cell.scenario, cell.parameters, policy.audit, policy.seed):
            same_set[identity] = position
            assignments.append(Assignment(Outcome.SIMULATED, donor=donor, leader=leader, audited=True))
        else:
            assignments.append(Assignment(Outcome.REUSED, donor=donor, leader=leader))
    return assignments

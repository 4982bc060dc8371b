"""Scores of runs: formulas of measures. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass

from drivecal.bundles.expressions import Formula, UndefinedError
from drivecal.domain.scales import Scale

LARGEST = 1e15
"""Largest size of a score. Sums and ranks of larger ones could overflow; only a formula near a division by zero gives them."""


@dataclass(frozen=True, slots=True)
class Scored:
    """A score. `undefined`: why the formula has no value, so that the run has the worth of a failed one."""

    value: float
    undefined: str | None = None


def rate(formula: Formula, scale: Scale, measures: Mapping[str, float], failure: str | None) -> Scored | None:
    """Returns the score of a run; None if it lacks a measure of the formula.

    A failed run, and a run for which the formula is undefined, is worth `scale.failed`; no run is worth less.
    """
    if failure is not None:
        return Scored(scale.failed)
    if not formula.names <= measures.keys():
        return None
    try:
        value = formula(measures)
    except UndefinedError as error:
        return Scored(scale.failed, str(error))
    if abs(value) > LARGEST:
        return Scored(scale.failed, f"{formula.text} is {value:g}, beyond {LARGEST:g}")
    return Scored(scale.worth(value))

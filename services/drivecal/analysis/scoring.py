"""Scores of runs: formulas of measures. Pure."""

from collections.abc import Mapping

from drivecal.bundles.expressions import Formula, UndefinedError
from drivecal.domain.evaluations import Rating
from drivecal.domain.scales import Scale

LARGEST = 1e15
"""Largest size of a score. Sums and ranks of larger ones could overflow; only a formula near a division by zero gives them."""

REMEDY = "give a `failed` that is worse than any run's value; without one, the end of `range` counts"
"""Remedy for scores that are cut off."""


def rate(formula: Formula, scale: Scale, measures: Mapping[str, float], failure: str | None) -> Rating | None:
    """Returns the rating of a run; None if it lacks a measure of the formula.

    A failed run, and a run for which the formula is undefined, is worth `scale.failed`; no run is worth less.
    """
    if failure is not None:
        return Rating(scale.failed, scale.failed)
    if not formula.names <= measures.keys():
        return None
    try:
        value = formula(measures)
    except UndefinedError as error:
        return Rating(scale.failed, scale.failed, str(error))
    if abs(value) > LARGEST:
        return Rating(scale.failed, scale.failed, f"{formula.text} is {value:g}, beyond {LARGEST:g}")
    worth = scale.worth(value)
    return Rating(worth, worth, cut=value if scale.cuts(value) else None)


def cut_text(scenario: str, score: str, value: float, failed: float) -> str:
    """Returns a sentence on a score of this true value that counts as a failed run's."""
    return f"{scenario}: {score} is {value:g} and counts as {failed:g}, the worth of a failed run; {REMEDY}"

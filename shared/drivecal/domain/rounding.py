"""Comparison of numbers at their own scale, whatever their unit and offset: all that ranks, compares or learns uses it.

Functions of arrays import numpy themselves: clients and the command line compare single numbers only, and start without it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Floats = npt.NDArray[np.float64]

SHARE = 1e-9
"""Share of a declared range up to which numbers count as equal."""
NOISE = 2.0**-48
"""Relative difference up to which numbers count as equal: sixteen units in the last place, more than the order of a sum changes."""


def grain(*values: float, span: float = 0.0) -> float:
    """Returns the largest difference of numbers that is rounding. `span`: width of their declared range, 0 without one."""
    return max(SHARE * span, NOISE * max(map(abs, values), default=0.0))


def same(first: float | None, other: float | None, span: float = 0.0) -> bool:
    """Returns whether numbers are equal but for rounding; a missing number equals a missing one."""
    if first is None or other is None:
        return first is other
    return first == other or abs(first - other) <= grain(first, other, span=span)


def grains(first: Floats, other: Floats | float, span: Floats | float = 0.0) -> Floats:
    """Returns `grain` of each pair of numbers; infinite ones have none."""
    import numpy as np

    sizes = (np.where(np.isfinite(each), np.abs(each), 0.0) for each in (first, np.asarray(other)))
    return np.asarray(np.maximum(SHARE * np.asarray(span), NOISE * np.maximum(*sizes)), dtype=np.float64)


def levels(values: Floats, span: float = 0.0) -> npt.NDArray[np.int64]:
    """Returns the place of each number among the distinct ones, from 0 for the lowest, shape (n,): neighbours that are equal but for
    rounding share it. Numbers are finite or infinite."""
    import numpy as np

    result = np.zeros(len(values), dtype=np.int64)
    order = np.argsort(values, kind="stable")
    rising = values[order]
    with np.errstate(invalid="ignore", over="ignore"):
        apart = np.diff(rising) > grains(rising[1:], rising[:-1], span)
    result[order[1:]] = np.cumsum(apart)
    return result

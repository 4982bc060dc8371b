"""Comparison of numbers at their own scale, whatever their unit and offset: all that ranks, compares or learns uses it.

Functions of arrays import numpy themselves: clients and the command line compare single numbers only, and start without it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Floats = npt.NDArray[np.float64]

SHARE = 1e-9
"""Share of a declared range up to which numbers count as equal."""
NOISE = 2.0**-48
"""Relative difference up to which numbers count as equal: sixteen units in the last place, more than the order of a sum changes."""
FAR = 2.0**10
"""Offset, in spreads, from which on numbers are shifted before they are learned from."""


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


@dataclass(frozen=True, slots=True)
class Scaling:
    """Brings numbers near 1: less `centre`, in units of `unit`, a power of two. So numbers of usual size keep all their digits."""

    centre: float = 0.0
    unit: float = 1.0

    @classmethod
    def of(cls, values: Floats) -> Scaling:
        """Returns the scaling of numbers; NaN and infinite ones are left out."""
        import numpy as np

        known = values[np.isfinite(values)]
        if not known.size:
            return cls()
        size = float(np.abs(known).max())
        spread = 0.5 * float(known.max()) - 0.5 * float(known.min())  # halves: the range of finite numbers may be infinite
        if spread <= grain(size):
            return cls(float(known[0]), 1.0)
        centre = float(np.median(known)) if size > FAR * spread else 0.0
        return cls(centre, float(2.0 ** np.floor(np.log2(spread))))

    def __call__(self, values: Floats) -> Floats:
        """Returns scaled numbers."""
        import numpy as np

        return np.asarray((values - self.centre) / self.unit, dtype=np.float64)

    def undone(self, scaled: Floats) -> Floats:
        """Inverts the scaling."""
        import numpy as np

        return np.asarray(scaled * self.unit + self.centre, dtype=np.float64)

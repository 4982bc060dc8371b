"""Grid indices as bit strings, the genetic algorithm's chromosomes (Section II-B of the paper).

A parameter with n values gets the fewest bits k with 2**k >= n; its bit pattern b, most significant bit first, means the grid index
round(b (n - 1) / (2**k - 1)). That quotient never ends in exactly one half, 2**k - 1 being odd, so its rounding needs no rule. Every
index has at least one pattern; where 2**k > n some have two.

Continuous parameters have up to 51 bits, integers up to 21: a flip of a random bit is a step of a random order of magnitude. The patterns
of choices have no meaning beyond their identity.
"""

from functools import cached_property

import numpy as np
import numpy.typing as npt

from drivecal.domain.parameters import Indices
from drivecal.optimizers.checks import searchable

Bits = npt.NDArray[np.bool_]
LARGEST = 2**63 - 1
"""Largest product that 64 bits hold."""


class BitEncoding:
    """The chromosomes of one search space: the patterns of all parameters, one after the other."""

    def __init__(self, n_values: Indices) -> None:
        """`n_values`: grid sizes, shape (n_searched,). Raises InvalidInputError if there is nothing to search."""
        self.n_values = searchable(n_values)
        self.bits: Indices = np.array([(n - 1).bit_length() for n in n_values.tolist()], dtype=np.int64)
        """Bits per parameter, k, shape (n_searched,)."""

    @cached_property
    def _largest(self) -> Indices:
        return np.array([2**k - 1 for k in self.bits.tolist()], dtype=np.int64)

    @cached_property
    def _starts(self) -> Indices:
        return np.cumsum(self.bits) - self.bits

    @cached_property
    def _shifts(self) -> Indices:
        return np.concatenate([np.arange(k - 1, -1, -1) for k in self.bits.tolist()])

    def indices(self, patterns: Indices) -> Indices:
        """The grid indices that bit patterns mean; both of shape (n, n_searched)."""
        return _scaled(patterns, self.n_values - 1, self._largest)

    def patterns(self, indices: Indices) -> Indices:
        """Returns the bit pattern of each grid index, the middle of its patterns; both of shape (n, n_searched)."""
        return _scaled(indices, self._largest, self.n_values - 1)

    def chromosomes(self, patterns: Indices) -> Bits:
        """The bits of `patterns`, shape (n, n_searched), as one array per individual, shape (n, n_bits)."""
        return (np.repeat(patterns, self.bits, axis=1) >> self._shifts & 1).astype(np.bool_)

    def from_chromosomes(self, chromosomes: Bits) -> Indices:
        """The inverse of `chromosomes`: patterns, shape (n, n_searched)."""
        place_values = chromosomes.astype(np.int64) << self._shifts
        patterns: Indices = np.add.reduceat(place_values, self._starts, axis=1)
        return patterns


def _scaled(values: Indices, factors: Indices, divisors: Indices) -> Indices:
    """Returns values x factors / divisors, rounded to the nearest integer, exactly; shapes (n, n_searched) and twice (n_searched,)."""
    scaled = (2 * values * factors + divisors) // (2 * divisors)
    for column, (factor, divisor) in enumerate(zip(factors.tolist(), divisors.tolist(), strict=True)):
        if (2 * factor + 1) * divisor > LARGEST or (2 * divisor + 1) * factor > LARGEST:  # a continuous parameter
            scaled[:, column] = [(2 * value * factor + divisor) // (2 * divisor) for value in values[:, column].tolist()]
    return scaled

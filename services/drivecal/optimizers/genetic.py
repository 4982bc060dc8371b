"""The paper's genetic algorithm on bit strings (Section II-B, Figure 2).

One generation, after `ranking`: the fittest p_s N individuals are eligible; p_s p_r N of them are drawn as parents and paired at random;
each pair has one child; the children replace the least fit. The paper leaves the replacement open, this is our reading of it:
shared/decisions/003-genetic-replacement-reading.md.

A parameter with n values gets the fewest bits k with 2**k >= n; its bit pattern b, most significant bit first, means the grid index
round(b (n - 1) / (2**k - 1)). That quotient never ends in exactly one half, 2**k - 1 being odd, so its rounding needs no rule. Every
index has at least one pattern; where 2**k > n some have two.

Continuous parameters have up to 51 bits, integers up to 21: a flip of a random bit is a step of a random order of magnitude. The patterns
of choices have no meaning beyond their identity.
"""

import numpy as np
import numpy.typing as npt

from drivecal.domain.parameters import Indices
from drivecal.optimizers.population import ReplacementOptimizer
from drivecal.optimizers.repair import searchable

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
        self._largest: Indices = np.array([2**k - 1 for k in self.bits.tolist()], dtype=np.int64)
        self._starts: Indices = np.cumsum(self.bits) - self.bits
        self._shifts: Indices = np.concatenate([np.arange(k - 1, -1, -1) for k in self.bits.tolist()])

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


def pairs_per_generation(population: int, selection: float, recombination: float) -> int:
    """Children per generation: half of p_s p_r N rounded, at least one (280 of 1,000 with the paper's 0.8 and 0.7)."""
    return max(1, round(selection * recombination * population) // 2)


def recombine(first: Bits, second: Bits, generator: np.random.Generator) -> Bits:
    """Two-point crossover of the whole chromosome: a stretch of `second` between two random cuts in `first`; shapes (n, n_bits).

    The paper crosses the concatenated array but does not name the operator. Two cuts keep most values whole, as one cut does, but do
    not tie the last parameter to the opposite of the first.
    """
    n, n_bits = first.shape
    cut: Indices = generator.integers(0, n_bits + 1, size=(n, 1))
    other: Indices = generator.integers(0, n_bits, size=(n, 1))
    other += other >= cut  # two different ones of the n_bits + 1 places between bits, both ends included
    position = np.arange(n_bits)
    inside = (position >= np.minimum(cut, other)) & (position < np.maximum(cut, other))
    return np.where(inside, second, first)


def mutate(chromosomes: Bits, probability: float, generator: np.random.Generator) -> Bits:
    """Flips one random bit of each chromosome with `probability`; shapes (n, n_bits)."""
    n, n_bits = chromosomes.shape
    hit = np.flatnonzero(generator.random(n) < probability)
    # a position for each, hit or not: the number of draws must not depend on their outcome
    position: Indices = generator.integers(0, n_bits, size=(n,))
    mutants = chromosomes.copy()
    mutants[hit, position[hit]] ^= True
    return mutants


class GeneticAlgorithm(ReplacementOptimizer):
    """Individuals are bit patterns, not indices: where an index has two patterns, both are kept apart."""

    def __init__(
        self,
        start: Indices,
        n_values: Indices,
        *,
        selection: float,
        recombination: float,
        mutation: float,
        generator: np.random.Generator,
    ) -> None:
        """`start`: grid indices of the first population, shape (n, n_searched), n >= 2. The probabilities are the paper's p_s, p_r, p_m."""
        self._encoding = BitEncoding(n_values)
        super().__init__(self._encoding.patterns(start), generator)
        self._eligible = max(2, round(selection * len(start)))
        self._pairs = pairs_per_generation(len(start), selection, recombination)
        self._mutation = mutation

    def _indices(self, individuals: Indices) -> Indices:
        return self._encoding.indices(individuals)

    def _newcomers(self, order: Indices) -> Indices:
        # drawn without replacement in random order, which pairs them at random as well
        parents = self._generator.choice(order[: self._eligible], size=2 * self._pairs, replace=False)
        chromosomes = self._encoding.chromosomes(self._individuals[parents])
        children = recombine(chromosomes[: self._pairs], chromosomes[self._pairs :], self._generator)
        return self._encoding.from_chromosomes(mutate(children, self._mutation, self._generator))

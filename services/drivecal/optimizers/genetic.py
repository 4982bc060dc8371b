"""The paper's genetic algorithm on bit strings (Section II-B, Figure 2).

One generation, after `ranking`: the fittest p_s N individuals are eligible; p_s p_r N of them are drawn as parents and paired at random;
each pair has one child; the children replace the least fit. The paper leaves the replacement open, this is our reading of it:
shared/decisions/003-genetic-replacement-reading.md.
"""

import numpy as np

from drivecal.domain.parameters import Indices
from drivecal.optimizers.encoding import BitEncoding, Bits
from drivecal.optimizers.replacement import ReplacementOptimizer


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

"""Random search, the floor that every optimizer has to beat."""

import numpy as np

from drivecal.domain.parameters import Indices
from drivecal.optimizers.replacement import ReplacementOptimizer


class RandomSearch(ReplacementOptimizer):
    """Replaces the least fit by points drawn uniformly from the grid, as many in every iteration; individuals are grid indices."""

    def __init__(self, start: Indices, n_values: Indices, *, renewed: int, generator: np.random.Generator) -> None:
        """`start`: grid indices of the first population, shape (n, n_searched). `renewed`: how many are replaced in each iteration."""
        super().__init__(start, generator)
        self._n_values = n_values
        self._renewed = renewed

    def _indices(self, individuals: Indices) -> Indices:
        return individuals.copy()

    def _newcomers(self, order: Indices) -> Indices:  # noqa: ARG002  who is fit does not matter here
        return self._generator.integers(0, self._n_values, size=(self._renewed, len(self._n_values)))

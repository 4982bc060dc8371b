"""The paper's particle swarm (Section II-B, Equations 4 and 5) on the grid.

Positions and velocities live in the unit cube, one axis per parameter; what is proposed is the grid point next to each position. What
the paper leaves open is decided in shared/decisions/010-particle-swarm-reading.md.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from drivecal.domain.parameters import Indices
from drivecal.domain.rounding import grains
from drivecal.optimizers.population import dump_floats, dump_generator, fitness, load_floats, load_generator, ranking
from drivecal.optimizers.repair import checked_answers, fitting, searchable
from drivecal.plugins.ports import Floats, Proposal


class ParticleSwarm:
    """Ask/tell; `ask` answers with the same proposal until `tell` has been called. A particle whose grid point stays the same is not
    `changed`: it has its answer already."""

    def __init__(
        self, start: Indices, n_values: Indices, *, c1: float, c2: float, inertia: float, generator: np.random.Generator
    ) -> None:
        """`start`: grid indices of the first positions, shape (n, n_searched). `c1`, `c2` and `inertia` are the factors of Eq. 4: the
        pull of a particle's own best position, of the best of all, and the share of its velocity that it keeps."""
        self._last = (searchable(n_values) - 1).astype(np.float64)
        self._c1, self._c2, self._inertia = c1, c2, inertia
        self._generator = generator
        self._positions: Floats = start / self._last
        # half way to a random point (SPSO 2007): as fast as the space is wide, and no particle is sent out of it
        self._velocities: Floats = 0.5 * (generator.random(start.shape) - self._positions)
        self._best_positions = self._positions.copy()
        self._best_fitness: Floats = np.full((len(start), 2), -np.inf)
        self._changed = np.ones(len(start), dtype=np.bool_)
        self._told = False

    def ask(self) -> Proposal:
        """Returns the next positions."""
        if self._told:
            before = self._indices()
            self._move()
            self._changed = (self._indices() != before).any(axis=1)
            self._told = False
        return Proposal(self._indices(), self._changed.copy())

    def tell(self, objectives: Floats, tie_breakers: Floats) -> None:
        """The answers to the last `ask`, see `drivecal.plugins.ports.Optimizer`.

        Raises RuntimeError if they were given already, ValueError if there is no finite number or NaN per particle.
        """
        reached = fitness(*checked_answers(objectives, tie_breakers, len(self._changed), told=self._told))
        (first, second), (best, best_second) = reached.T, self._best_fitness.T
        with np.errstate(invalid="ignore"):  # infinity less infinity
            equal = (first == best) | (np.abs(first - best) <= grains(first, best))
        better = np.where(equal, second > best_second, first > best)
        self._best_fitness[better] = reached[better]
        self._best_positions[better] = self._positions[better]
        self._told = True

    def state(self) -> dict[str, Any]:
        """Returns the state as data for strict JSON."""
        return {
            "individuals": self._positions.tolist(),
            "velocities": self._velocities.tolist(),
            "best_individuals": self._best_positions.tolist(),
            "best_fitness": dump_floats(np.where(np.isinf(self._best_fitness), np.nan, self._best_fitness)),
            "changed": self._changed.tolist(),
            "told": self._told,
            "generator": dump_generator(self._generator),
        }

    def resume(self, state: Mapping[str, Any]) -> None:
        """Continues from `state`. Raises InvalidInputError if it belongs to a swarm of another size or another space."""
        self._positions = fitting(np.array(state["individuals"], dtype=np.float64), self._positions)
        self._velocities = np.array(state["velocities"], dtype=np.float64)
        self._best_positions = np.array(state["best_individuals"], dtype=np.float64)
        self._best_fitness = np.nan_to_num(load_floats(state["best_fitness"]), nan=-np.inf)
        self._changed = np.array(state["changed"], dtype=np.bool_)
        self._told = bool(state["told"])
        self._generator = load_generator(state["generator"])

    def _indices(self) -> Indices:
        indices: Indices = np.rint(self._positions * self._last).astype(np.int64)
        return indices

    def _move(self) -> None:
        """Equations 4 and 5. A particle that meets the edge of the space stops there, along that axis."""
        shape = self._positions.shape
        leader = self._best_positions[ranking(*self._best_fitness.T)[0]]
        own, common = self._generator.random(shape), self._generator.random(shape)
        self._velocities = (
            self._inertia * self._velocities
            + self._c1 * own * (self._best_positions - self._positions)
            + self._c2 * common * (leader - self._positions)
        )
        moved = self._positions + self._velocities
        self._positions = np.clip(moved, 0.0, 1.0)
        self._velocities = np.where(moved == self._positions, self._velocities, 0.0)

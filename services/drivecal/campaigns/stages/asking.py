"""Rounds of a search: whole populations of a generational optimizer, or the cells of a search by the cell.

A search computes in a thread of its own, so that a slow one keeps no other campaign waiting. A computation depends only
on stored rows and gives all that is stored of it, so that a process that dies repeats it with the same result.
"""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, wait
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.contracts.campaign import Repaired
from drivecal.domain.parameters import Indices
from drivecal.optimizers.repair import RepairingOptimizer, checked_proposal
from drivecal.plugins.ports import Optimizer
from drivecal.plugins.search import AskedCell, Search

PATIENCE_SECONDS = 0.1
"""Time for which the first check of a computation waits: most proposals take milliseconds and need no further turn of the dispatcher."""
WINDOW = 5
"""Rounds of a search by the cell that are under way: one is computed while the cells of the others are simulated."""
SMALLEST_ROOM, LARGEST_ROOM = 2, 1024
"""Cells of a round. With few under way, a search knows more when it asks."""
LIKE_ONE = 8
"""Largest number of workers with the same rounds as one worker: the requested sets do not depend on their number."""


def room_for(workers: int) -> int:
    """Returns the number of cells in a round that keeps this many workers busy, a power of two."""
    return SMALLEST_ROOM if workers <= LIKE_ONE else min(LARGEST_ROOM, 1 << (-(-workers // 3) - 1).bit_length())


@dataclass(frozen=True, slots=True)
class AskedRound:
    """Cells that a search asks for together."""

    population: Indices
    """Grid indices of its sets, shape (n, n_searched)."""
    changed: npt.NDArray[np.bool_]
    """Mask of the requested sets, shape (n,). The others were asked for before: they are unchanged, or equal after a repair."""
    cells: Sequence[tuple[int, int, int]]
    """Individual, place of the scenario and seed, in the order of asking, with rising seeds."""
    state: dict[str, Any]
    """State of the search, JSON-ready."""
    repaired: Repaired | None = None

    @property
    def unchanged(self) -> int:
        """Number of its sets that keep earlier answers."""
        return int((~self.changed).sum())


class PopulationAsker:
    """A generational optimizer: a round is its population, in all scenarios, and it is told when the whole round is answered."""

    def __init__(self, optimizer: Optimizer, problem: CalibrationProblem, populations: Sequence[Any]) -> None:
        """`populations`: grid indices of the newest population, or of all so far if proposals are repaired."""
        self._optimizer, self._problem = optimizer, problem
        self._evaluated = np.array(populations[-1], dtype=np.int64) if populations else None
        if isinstance(optimizer, RepairingOptimizer):
            optimizer.known.update(tuple(row) for population in populations for row in population)

    def ask(self) -> AskedRound:
        """Returns the next population. Raises InvalidInputError if a plug-in's does not fit the space."""
        chosen, n_values = self._problem.search, self._problem.space.n_values
        proposal = checked_proposal(chosen.plugin.name, self._optimizer.ask(), chosen.population, n_values, self._evaluated)
        self._evaluated = proposal.population
        changed, repaired = proposal.changed.copy(), None
        if isinstance(self._optimizer, RepairingOptimizer):
            changed[self._optimizer.again], repaired = False, self._optimizer.repaired
        return population_round(self._problem, proposal.population, changed, self._optimizer.state(), repaired)

    def tell(self, *answers: Any) -> None:
        """Passes objectives and tie breakers on."""
        self._optimizer.tell(*answers)


class CellAsker:
    """A search by the cell: a round is some cells of some sets."""

    def __init__(self, search: Search, room: int, seeds: int = 1) -> None:
        """`seeds`: number of seeds of each replicate; the search knows the means over them."""
        self._search, self._room, self._seeds = search, room, seeds

    def ask(self) -> AskedRound | None:
        """Returns the next cells; None if the search has nothing left to ask for."""
        cells = self._search.ask(max(1, self._room // self._seeds))
        if not cells:
            return None
        sets = list(dict.fromkeys(cell.indices for cell in cells))
        places = {indices: place for place, indices in enumerate(sets)}
        state = {"search": self._search.state(), "discarded": self._search.discarded}
        return AskedRound(
            np.array(sets, dtype=np.int64),
            np.ones(len(sets), dtype=np.bool_),
            sorted(
                (
                    (places[cell.indices], cell.scenario, (cell.replicate - 1) * self._seeds + seed)
                    for seed in range(1, self._seeds + 1)
                    for cell in cells
                ),
                key=lambda cell: cell[2],
            ),
            state,
        )

    def tell(self, *answers: Any) -> None:
        """Passes the answers of a round on."""
        self._search.tell(*answers)


Asker = PopulationAsker | CellAsker
"""A search as a campaign asks it."""


def population_round(
    problem: CalibrationProblem,
    population: Indices,
    changed: npt.NDArray[np.bool_],
    state: dict[str, Any],
    repaired: Repaired | None = None,
) -> AskedRound:
    """Returns the round of a population."""
    seeds, individuals, places = problem.least_replicates, np.flatnonzero(changed).tolist(), range(len(problem.scenarios))
    cells = [(each, place, seed) for seed in range(1, seeds + 1) for each in individuals for place in places]
    return AskedRound(population, changed, cells, state, repaired)


def cells_of(asked: AskedRound, seeds: int = 1) -> list[AskedCell]:
    """Returns the cells of a round as its search asked for them: each once, for all `seeds` of a replicate."""
    return [
        AskedCell(tuple(asked.population[individual].tolist()), scenario, 1 + (seed - 1) // seeds)
        for individual, scenario, seed in asked.cells
        if (seed - 1) % seeds == 0
    ]


class Computation:
    """Creates or restores a search, passes it answers and asks for its next round, in a thread of its own."""

    def __init__(self, obtain: Callable[[], Asker], answers: tuple[Any, ...] | None, *, asks: bool) -> None:
        """Begins to compute.

        Args:
            obtain: returns the search.
            answers: arguments of the search's `tell`, which is called first; None for no call.
            asks: whether a round is wanted.
        """
        self._patience = PATIENCE_SECONDS
        self._outcome = outcome = Future[tuple[Asker, AskedRound | None]]()
        self.asks = asks

        def compute() -> None:
            try:
                asker = obtain()
                if answers is not None:
                    asker.tell(*answers)
                outcome.set_result((asker, asker.ask() if asks else None))
            except BaseException as error:  # noqa: BLE001  # `result` raises it in the dispatcher's thread
                outcome.set_exception(error)

        # A daemon: a process that ends waits for no optimizer.
        threading.Thread(target=compute, name="optimizer", daemon=True).start()

    @property
    def is_done(self) -> bool:
        """Returns whether the result is there; only the first check waits for it, `PATIENCE_SECONDS` at most."""
        wait([self._outcome], self._patience)
        self._patience = 0.0
        return self._outcome.done()

    def result(self) -> tuple[Asker, AskedRound | None]:
        """Returns the search and its next round, None if it was not asked or has nothing left to ask for.

        Raises what the search raised. Waits for the result unless it `is_done`.
        """
        return self._outcome.result()

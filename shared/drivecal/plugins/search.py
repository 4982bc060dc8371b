"""The port of searches: they ask for cells and are told the answer of each.

A cell is a parameter set in a scenario. A campaign asks a search in rounds. Round n knows the answers of the rounds up to n - `window`
and nothing else, so that what is asked depends on the search's seed alone, not on workers, timing or a restart.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel

from drivecal.domain.parameters import Indices, Kind
from drivecal.plugins.ports import Ability, Floats, Named


@dataclass(frozen=True, slots=True)
class AskedCell:
    """A cell that a search asks for: the grid indices of its set, by searched parameter, and the place of its scenario.

    The runs of a random simulator have seeds, the same for all sets.
    """

    indices: tuple[int, ...]
    scenario: int
    replicate: int = 1
    """The first, second, ... answer of this set in this scenario, each under a seed of its own."""


@dataclass(frozen=True, slots=True)
class CellAnswer:
    """The answer of a cell."""

    cell: AskedCell
    values: tuple[float, ...]
    """One number for each of `Aim.values`; NaN without a result."""
    failed: bool = False
    """The run failed: its values are the worth of a failed run, or there is no result."""


class Aim(Protocol):
    """Makes objectives of the values of a set in its scenarios. Pure.

    Values of n sets have the shape (n, n_scenarios, n_values).
    """

    @property
    def scenarios(self) -> int:
        """Number of scenarios."""

    @property
    def values(self) -> int:
        """Number of values of a cell."""

    @property
    def objectives(self) -> int:
        """Number of objectives, m."""

    @property
    def best(self) -> Floats:
        """The best value to be expected of each cell, shape (n_scenarios, n_values); infinite without a limit.

        Usual ranges give them: a search trusts them until an answer is better.
        """

    @property
    def worst(self) -> Floats:
        """The value of a failed run, shape (n_scenarios, n_values); NaN if it has none."""

    def judge(self, values: Floats) -> tuple[Floats, Floats]:
        """Returns the objectives, higher is better, shape (n, m), and the violations of constraints on results, 0 if they are kept, shape
        (n,). NaN if a value is missing."""


@dataclass(frozen=True)
class SearchTask:
    """The space and the aim of a search.

    Args:
        n_values: grid sizes, shape (n_searched,).
        kinds: kinds of the parameters, in the same order.
        aim: what makes objectives of values.
        repair: returns rows of grid indices, shape (n, n_searched), with a feasible and distinct row near each infeasible one.
        feasible: returns which rows of grid indices keep all constraints, shape (n,).
        sample: returns up to n feasible rows, spread over the space, drawn by a generator.
        start: sets to ask for first, shape (k, n_searched): the baseline and sets from expert knowledge.
        known: answers that are known before the search begins.
        cells: number of cells that the search may ask for; None if unlimited.
        window: number of rounds that are under way at most.
        random: whether answers depend on a seed.
        replicates: most replicates of a cell.
        given: returns the values of sets that are known without an answer, the same in each scenario, shape (n, n_values); NaN for others.
        references: sets with which objectives or constraints compare, shape (k, n_searched).
        variants: further aims over the same cells, each about some of the scenarios. A search may look for the best set of each as well:
            `aim` is what they have in common.
    """

    n_values: Indices
    kinds: Sequence[Kind]
    aim: Aim
    feasible: Callable[[Indices], npt.NDArray[np.bool_]]
    repair: Callable[[Indices], Indices]
    sample: Callable[[int, np.random.Generator], Indices]
    start: Indices
    known: Sequence[CellAnswer] = ()
    cells: int | None = None
    window: int = 1
    random: bool = False
    replicates: int = 1
    given: Callable[[Indices], Floats] | None = None
    references: Indices | None = None
    variants: Sequence[Aim] = ()

    def with_given(self, rows: Indices, values: Floats) -> Floats:
        """Returns values of n sets, shape (..., n, n_scenarios, n_values), with what is known of them without an answer."""
        if self.given is None:
            return values
        known = self.given(rows)[:, np.newaxis]
        return np.where(np.isnan(known), values, known)


class Search(Protocol):
    """A search by the cell. Deterministic: what it asks for depends only on its task, its seed and the calls before."""

    def ask(self, room: int) -> Sequence[AskedCell]:
        """Returns the cells of the next round, at most `room`, none twice; empty if the search is over.

        Cells of earlier rounds may be without an answer.
        """

    def tell(self, answers: Sequence[CellAnswer]) -> None:
        """Receives the answers of the oldest round that has not been told."""

    @property
    def discarded(self) -> int:
        """Cells that need no answer, because their set cannot be the best any more."""

    def state(self) -> dict[str, Any]:
        """Returns, as JSON-ready plain data, what cannot be computed from the rounds and their answers."""


@runtime_checkable
class SearchPlugin(Named, Protocol):
    """An optimizer that searches by the cell, which a campaign chooses by its `name` (`optimizer.kind`)."""

    @property
    def settings(self) -> type[BaseModel]:
        """Model of the campaign's `optimizer` section, with at least `kind` and `seed`."""

    @property
    def supports(self) -> frozenset[Ability]:
        """All abilities, `grid` included."""

    def begin(self, settings: BaseModel, task: SearchTask) -> Search:
        """Begins a search."""

    def resume(
        self,
        settings: BaseModel,
        task: SearchTask,
        rounds: Sequence[Sequence[AskedCell]],
        answers: Sequence[Sequence[CellAnswer]],
        state: Mapping[str, Any],
    ) -> Search:
        """Returns the search after these rounds.

        Args:
            settings: the campaign's settings.
            task: what the search was begun with.
            rounds: the cells of each round, in the order of asking.
            answers: the answers of the first rounds, as they were told.
            state: `Search.state` after the last round was asked.
        """

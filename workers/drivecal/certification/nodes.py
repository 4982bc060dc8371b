"""Planning states as nodes of a trie, stored compactly: what decides in them, and where each decision leads.

A driving function that can be certified decides by the lowest cost over candidates, with features that do not depend on any parameter. Of a
new state a node keeps what the features are computed from, some dozens of numbers. One that is asked for again and again is described: it
keeps the features of its contenders, the candidates that could win under some allowed parameters, as whole multiples of the function's
`grid`, two bytes each; the few that do not fit into two bytes are kept beside as they are. Nothing is rounded: what comes out is bit for
bit what went in.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from drivecal.certification.kernels import NONE, count_beside, digest, follow, link, move, pack, unpack

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int32]

INFEASIBLE = 32768
"""Added to the number of a candidate that is known to be."""


class Nodes:
    """One row per node; row 0 is the state in which every run begins. A child's number is larger than its parent's. Arrays grow."""

    def __init__(self, n_values: int, n_candidates: int, grid: float) -> None:
        """`n_values` numbers describe a candidate for its cost, of `n_candidates`; `grid`: a power of two that most of these numbers are
        multiples of. Raises ValueError for more candidates than can be numbered."""
        if n_candidates > INFEASIBLE:
            raise ValueError(f"{n_candidates} candidates are too many to be certified; at most {INFEASIBLE}")
        self.grid, self.n_candidates = grid, n_candidates
        self.packed: npt.NDArray[np.uint16] = np.zeros((0, n_values), dtype=np.uint16)
        """The contenders of all nodes, one row each."""
        self.candidate: npt.NDArray[np.uint16] = np.zeros(0, dtype=np.uint16)
        """Which candidate a row is, plus INFEASIBLE where it is known to be."""
        self.row_start: npt.NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self.row_count: Integers = np.zeros(0, dtype=np.int32)
        """0: the node is not described yet."""
        self.digest: npt.NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        """Of the planning state; 0 where none is known."""
        self.state: Integers = np.zeros(0, dtype=np.int32)
        """Where in `states` the planning state is; NONE where it is described, or none is known."""
        self.asked: Integers = np.zeros(0, dtype=np.int32)
        """How often it was decided in the state."""
        self.visited: npt.NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        """When it, or a node below it, was last."""
        self.parent: Integers = np.zeros(0, dtype=np.int32)
        self.decision: Integers = np.zeros(0, dtype=np.int32)
        """The candidate that led from the parent to this node."""
        self.first_child: Integers = np.zeros(0, dtype=np.int32)
        self.next_sibling: Integers = np.zeros(0, dtype=np.int32)
        self.leaf: Integers = np.zeros(0, dtype=np.int32)
        """The number of the run that ended here; NONE where none did."""
        self.beside_start: npt.NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self.beside_count: Integers = np.zeros(0, dtype=np.int32)
        self.places: Integers = np.zeros(0, dtype=np.int32)
        self.values: Floats = np.zeros(0)
        self.states: Floats = np.zeros((0, 0))
        self._free: list[int] = []
        """Rows of `states` that are not used any more."""
        self.count = self.rows = self.beside = self.kept = 0
        self._add(np.array([NONE]), np.array([NONE]))
        self._per_node = sum(getattr(self, name).itemsize for name in _OF_NODES)

    @property
    def bytes(self) -> int:
        """Memory in use."""
        per_row = self.packed.itemsize * (self.packed.shape[1] + 1)
        per_state = self.states.itemsize * self.states.shape[1]
        beside = self.beside * (self.places.itemsize + self.values.itemsize)
        return self.count * self._per_node + self.rows * per_row + self.kept * per_state + beside

    def extend(self, decisions: Sequence[int], states: Floats) -> tuple[int, int | None]:
        """Adds a run: its `decisions`, shape (n,), and the states in which they were made, shape (n, n_state).

        Gives the node where it ended. Where the same decisions led to another state than before nothing is added: then gives the number
        of that decision as well.
        """
        made, digests = np.array(decisions, dtype=np.int64), np.empty(len(decisions), dtype=np.int64)
        digest(states, digests)
        node, depth, same = follow(made, digests, self.first_child, self.next_sibling, self.decision, self.digest)
        if not same:
            return node, depth
        if depth == len(made):
            return node, None
        if not self.digest[node]:
            self._remember(np.array([node]), states[depth : depth + 1], digests[depth : depth + 1])
        first, end = self.count, self.count + len(made) - depth - 1
        self._add(np.array([node, *range(first, end)]), made[depth:])
        self._remember(np.arange(first, end), states[depth + 1 :], digests[depth + 1 :])
        return end, None

    def _add(self, parents: npt.NDArray[np.int64], decisions: npt.NDArray[np.int64]) -> None:
        """New nodes, nothing known of them; each but the first is the only child of the one before."""
        start, stop = self.count, self.count + len(parents)
        self._grow(_OF_NODES, stop)
        new = slice(start, stop)
        self.parent[new], self.decision[new] = parents, decisions
        for name in ("first_child", "next_sibling", "leaf", "state"):
            getattr(self, name)[new] = NONE
        for name in ("visited", "digest", "asked", "row_start", "row_count", "beside_start", "beside_count"):
            getattr(self, name)[new] = 0
        self.first_child[start : stop - 1] = np.arange(start + 1, stop)
        parent = int(parents[0])
        if parent != NONE:
            self.next_sibling[start], self.first_child[parent] = self.first_child[parent], start
        self.count = stop

    def _remember(self, nodes: npt.NDArray[np.int64], states: Floats, digests: npt.NDArray[np.int64]) -> None:
        """Keeps the planning states of nodes of which none was known."""
        used = self._free[len(self._free) - min(len(nodes), len(self._free)) :]
        del self._free[len(self._free) - len(used) :]
        rows = np.array([*used, *range(self.kept, self.kept + len(nodes) - len(used))], dtype=np.int32)
        self.kept += len(nodes) - len(used)
        if not self.states.shape[1]:
            self.states = np.zeros((0, states.shape[1]))
        self._grow(("states",), self.kept)
        self.states[rows] = states
        self.state[nodes], self.digest[nodes] = rows, digests

    def child(self, node: int, chosen: int) -> int:
        """The node that `chosen` leads to from `node`; NONE where that was never driven."""
        child = int(self.first_child[node])
        while child != NONE and self.decision[child] != chosen:
            child = int(self.next_sibling[child])
        return child

    def describe(
        self,
        node: int,
        candidates: npt.NDArray[np.int64],
        features: Floats,
        infeasible: npt.NDArray[np.bool_],
    ) -> None:
        """Keeps the contenders of a state, shape (n,), with their features, shape (n, n_values), in place of what was kept. `infeasible`,
        shape (n_candidates,): those known to be."""
        if self.state[node] != NONE:
            self._free.append(int(self.state[node]))
            self.state[node] = NONE
        start, stop = self.rows, self.rows + len(candidates)
        beside = count_beside(features, 1.0 / self.grid)
        self._grow(_OF_ROWS, stop)
        self._grow(_OF_BESIDE, self.beside + beside)
        pack(features, 1.0 / self.grid, self.packed[start:stop], self.places[self.beside :], self.values[self.beside :])
        self.candidate[start:stop] = candidates + INFEASIBLE * infeasible[candidates]
        self.row_start[node], self.row_count[node] = start, len(candidates)
        self.beside_start[node], self.beside_count[node] = self.beside, beside
        self.rows, self.beside = stop, self.beside + beside

    def contenders(self, node: int) -> tuple[npt.NDArray[np.uint16], npt.NDArray[np.bool_], Floats]:
        """The contenders of a described node, shape (n,), which of them are infeasible, and their features, shape (n, n_values)."""
        start, stop = self.row_start[node], self.row_start[node] + self.row_count[node]
        found = np.empty((stop - start, self.packed.shape[1]))
        beside = slice(self.beside_start[node], self.beside_start[node] + self.beside_count[node])
        unpack(self.packed[start:stop], self.grid, self.places[beside], self.values[beside], found)
        candidates = self.candidate[start:stop]
        return candidates % INFEASIBLE, candidates >= INFEASIBLE, found

    def infeasible(self, node: int) -> npt.NDArray[np.bool_]:
        """The contenders of a node that are known to be infeasible, as candidates, shape (n_candidates,)."""
        candidates = self.candidate[self.row_start[node] : self.row_start[node] + self.row_count[node]]
        found = np.zeros(self.n_candidates, dtype=np.bool_)
        found[candidates[candidates >= INFEASIBLE] - INFEASIBLE] = True
        return found

    def keep(self, wanted: npt.NDArray[np.bool_]) -> None:
        """Forgets the nodes that are not `wanted`, shape (count,): with a node all its ancestors must be. The others get new numbers, in
        the order of the old ones; the memory of those that are gone is given back."""
        old = np.flatnonzero(wanted)
        number = np.full(self.count, NONE, dtype=np.int32)
        number[old] = np.arange(len(old), dtype=np.int32)
        for name in _OF_NODES:
            setattr(self, name, getattr(self, name)[old])
        self.parent[1:] = number[self.parent[1:]]
        link(self.parent, self.first_child, self.next_sibling)
        self.count = len(old)
        kept = np.flatnonzero(self.state != NONE)
        self.states, self._free, self.kept = self.states[self.state[kept]], [], len(kept)
        self.state[kept] = np.arange(len(kept), dtype=np.int32)
        self._move(_OF_ROWS, "row_start", int(self.row_count.sum()))
        self._move(_OF_BESIDE, "beside_start", int(self.beside_count.sum()))
        self.rows, self.beside = len(self.candidate), len(self.places)

    def _move(self, names: tuple[str, ...], starts: str, length: int) -> None:
        before = getattr(self, starts)
        counts = self.row_count if starts == "row_start" else self.beside_count
        for name in names:
            array = getattr(self, name)
            moved, places = np.empty((length, *array.shape[1:]), dtype=array.dtype), before.copy()
            move(places, counts, *(one if one.ndim == 2 else one[:, None] for one in (array, moved)))
            setattr(self, name, moved)
        setattr(self, starts, places)

    def _grow(self, names: tuple[str, ...], length: int) -> None:
        if length <= len(getattr(self, names[0])):
            return
        for name in names:
            array = getattr(self, name)
            # in place: large blocks are not copied but mapped anew, so that no second copy has to fit into memory for a moment
            array.resize((max(64, length + length // 8), *array.shape[1:]), refcheck=False)


_OF_NODES = (
    "row_start",
    "row_count",
    "digest",
    "state",
    "asked",
    "visited",
    "parent",
    "decision",
    "first_child",
    "next_sibling",
    "leaf",
    "beside_start",
    "beside_count",
)
_OF_ROWS = ("packed", "candidate")
_OF_BESIDE = ("places", "values")


def walk(nodes: Nodes, node: int, costs: Callable[[npt.NDArray[np.uint16], Floats], Floats]) -> int:
    """`ports.CertifiablePlanner.walk` for planners without a compiled one; `costs` gives the costs of contenders, shape (n,), from their
    numbers and features, by the very arithmetic that plans.

    Ties go to the lowest candidate.
    """
    while nodes.row_count[node]:
        candidates, infeasible, features = nodes.contenders(node)
        found = costs(candidates, features)
        allowed = found if infeasible.all() else np.where(infeasible, np.inf, found)
        child = nodes.child(node, int(candidates[np.argmin(allowed)]))
        if child == NONE:
            return node
        node = child
    return node

"""Planning states as nodes of a trie, stored compactly: what decides in them, and where each decision leads.

A driving function that can be certified decides by the lowest cost over candidates, with features that do not depend on any parameter. A
node keeps the features of its contenders, the candidates that could win under some allowed parameters, as whole multiples of the
function's `grid`, two bytes each; the few that do not fit into two bytes are kept beside as they are. Nothing is rounded: what comes out
is bit for bit what went in.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

compiled = njit(cache=True, error_model="numpy")

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int32]

NONE = -1
BESIDE = 65535
"""Stands for a feature that is kept beside."""
INFEASIBLE = 32768
"""Added to the number of a candidate that is known to be."""


@compiled
def count_beside(features: Any, scale: float) -> int:
    """How many of `features`, shape (n, k), are no multiples of 1 / `scale` that fit into two bytes."""
    beside = 0
    for value in features.ravel():
        multiple = value * scale
        if not (0.0 <= multiple < BESIDE and multiple == np.floor(multiple)):
            beside += 1
    return beside


@compiled
def pack(features: Any, scale: float, packed: Any, places: Any, values: Any) -> None:
    """Writes `features`, shape (n, k), as multiples of 1 / `scale`; those that are none go to `places` and `values`."""
    beside = 0
    n, k = features.shape
    for row in range(n):
        for column in range(k):
            value = features[row, column]
            multiple = value * scale
            if 0.0 <= multiple < BESIDE and multiple == np.floor(multiple):
                packed[row, column] = np.uint16(multiple)
            else:
                packed[row, column] = BESIDE
                places[beside] = row * k + column
                values[beside] = value
                beside += 1


@compiled
def unpack(packed: Any, grid: float, places: Any, values: Any, features: Any) -> None:
    """The inverse of `pack`; `grid` is 1 / `scale`, both powers of two. A zero comes back without its sign."""
    n, k = features.shape
    for row in range(n):
        for column in range(k):
            features[row, column] = packed[row, column] * grid
    for index in range(len(places)):
        features[places[index] // k, places[index] % k] = values[index]


@compiled
def contenders(features: Any, lowest: Any, highest: Any, infeasible: Any, chosen: int, leaders: int, margin: float) -> Any:
    """The candidates that could have the lowest cost under weights between `lowest` and `highest`, in ascending order.

    `features`, shape (n, n_terms), one column per weight. A candidate is left out where one of `leaders` good ones that are not known to be
    `infeasible` costs less by more than `margin`, whatever the weights: rounding errors must be smaller than that. `chosen` always stays.
    """
    n, n_terms = features.shape
    columns, rank, number = np.empty((n_terms, n)), np.zeros(n), np.arange(n)
    for term in range(n_terms):
        middle = 0.5 * (lowest[term] + highest[term])
        for candidate in range(n):
            columns[term, candidate] = features[candidate, term]
            rank[candidate] += middle * features[candidate, term]
    for candidate in range(n):
        if infeasible[candidate]:
            rank[candidate] = np.inf
    gap = np.empty(n)
    left = n
    leader = chosen
    for _ in range(leaders):
        if rank[leader] == np.inf:
            leader = int(np.argmin(rank[:left]))
            if rank[leader] == np.inf:
                break
        rank[leader] = np.inf
        gap[:left] = 0.0
        for term in range(n_terms):
            base, low, high = columns[term, leader], lowest[term], highest[term]
            for place in range(left):
                difference = columns[term, place] - base
                gap[place] += difference * (low if difference > 0.0 else high)
        stay = 0
        for place in range(left):
            if not gap[place] > margin or number[place] == chosen:  # one that is no number beats nobody
                if stay < place:
                    number[stay], rank[stay] = number[place], rank[place]
                    for term in range(n_terms):
                        columns[term, stay] = columns[term, place]
                stay += 1
        left = stay
        leader = int(np.argmin(rank[:left]))
    return number[:left]


@compiled
def visit(node: int, parent: Any, visited: Any, clock: int) -> None:
    """Notes in a node and all its ancestors that they were visited."""
    while node >= 0:
        visited[node] = clock
        node = parent[node]


@compiled
def move(starts: Any, counts: Any, old: Any, new: Any) -> None:
    """Copies the `counts` rows from each of `starts` on from `old` to `new`, one after the other; `starts` becomes where they are."""
    place = 0
    for node in range(len(starts)):
        start = starts[node]
        starts[node] = place
        for index in range(start, start + counts[node]):
            for column in range(old.shape[1]):
                new[place, column] = old[index, column]
            place += 1


@compiled
def link(parent: Any, first_child: Any, next_sibling: Any) -> None:
    """Children of all nodes from their parents."""
    first_child[:] = NONE
    next_sibling[:] = NONE
    for node in range(1, len(parent)):
        next_sibling[node] = first_child[parent[node]]
        first_child[parent[node]] = node


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
        """Of the whole planning state."""
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
        self.count = self.rows = self.beside = 0
        self.add(NONE, NONE)
        self._per_node = sum(getattr(self, name).itemsize for name in _OF_NODES)

    @property
    def bytes(self) -> int:
        """Memory in use."""
        per_row = self.packed.itemsize * (self.packed.shape[1] + 1)
        return self.count * self._per_node + self.rows * per_row + self.beside * (self.places.itemsize + self.values.itemsize)

    def add(self, parent: int, decision: int) -> int:
        """A new node, not described yet."""
        node = self.count
        self._grow(_OF_NODES, node + 1)
        self.parent[node], self.decision[node], self.visited[node] = parent, decision, 0
        self.first_child[node] = self.next_sibling[node] = self.leaf[node] = NONE
        self.row_count[node] = self.beside_count[node] = 0
        if parent != NONE:
            self.next_sibling[node], self.first_child[parent] = self.first_child[parent], node
        self.count += 1
        return node

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
        digest: int,
    ) -> None:
        """Keeps the contenders of a state, shape (n,), with their features, shape (n, n_values), in place of what was kept. `infeasible`,
        shape (n_candidates,): those known to be."""
        start, stop = self.rows, self.rows + len(candidates)
        beside = count_beside(features, 1.0 / self.grid)
        self._grow(_OF_ROWS, stop)
        self._grow(_OF_BESIDE, self.beside + beside)
        pack(features, 1.0 / self.grid, self.packed[start:stop], self.places[self.beside :], self.values[self.beside :])
        self.candidate[start:stop] = candidates + INFEASIBLE * infeasible[candidates]
        self.row_start[node], self.row_count[node] = start, len(candidates)
        self.beside_start[node], self.beside_count[node] = self.beside, beside
        self.digest[node] = digest
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


def walk(nodes: Nodes, costs: Callable[[npt.NDArray[np.uint16], Floats], Floats]) -> int:
    """`ports.CertifiablePlanner.walk` for planners without a compiled one; `costs` gives the costs of contenders, shape (n,), from their
    numbers and features, by the very arithmetic that plans.

    Ties go to the lowest candidate.
    """
    node = 0
    while nodes.row_count[node]:
        candidates, infeasible, features = nodes.contenders(node)
        found = costs(candidates, features)
        allowed = found if infeasible.all() else np.where(infeasible, np.inf, found)
        child = nodes.child(node, int(candidates[np.argmin(allowed)]))
        if child == NONE:
            return node
        node = child
    return node

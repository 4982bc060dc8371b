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
ROWS_PER_NODE, BESIDE_PER_NODE = 64, 16
"""Room for contenders, and for features that do not fit into two bytes, on average."""


@compiled
def pack(features: Any, scale: float, packed: Any, places: Any, values: Any) -> int:
    """Writes `features`, shape (n, k), as multiples of 1 / `scale`. Those that are none go to `places` and `values`: how many, or -1
    where these have too little room."""
    beside = 0
    n, k = features.shape
    for row in range(n):
        for column in range(k):
            value = features[row, column]
            multiple = value * scale
            if 0.0 <= multiple < BESIDE and multiple == np.floor(multiple):
                packed[row, column] = np.uint16(multiple)
            else:
                if beside == len(places):
                    return -1
                packed[row, column] = BESIDE
                places[beside] = row * k + column
                values[beside] = value
                beside += 1
    return beside


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
    middle = np.zeros(n)
    for candidate in range(n):
        for term in range(n_terms):
            middle[candidate] += 0.5 * (lowest[term] + highest[term]) * features[candidate, term]
    order = np.argsort(middle)
    leading = np.empty(leaders, dtype=np.int64)
    leading[0] = chosen
    found = 0 if infeasible[chosen] else 1
    stays = np.zeros(n, dtype=np.bool_)
    stays[chosen] = True
    for candidate in order:
        beaten = False
        for place in range(found):
            gap = 0.0
            for term in range(n_terms):
                difference = features[candidate, term] - features[leading[place], term]
                gap += difference * (lowest[term] if difference > 0.0 else highest[term])
            if gap > margin:
                beaten = True
                break
        if not beaten and candidate != chosen:
            stays[candidate] = True
            if found < leaders and not infeasible[candidate]:
                leading[found] = candidate
                found += 1
    return np.flatnonzero(stays)


class Nodes:
    """One row per node in arrays of fixed room; row 0 is the state in which every run begins. A child's number is larger than its parent's.

    The room is virtual memory until rows are written.
    """

    def __init__(self, n_values: int, n_candidates: int, grid: float, room: int) -> None:
        """`n_values` numbers describe a candidate for its cost, of `n_candidates`; `grid`: a power of two that most of these numbers are
        multiples of; `room`: nodes."""
        self.room, self.grid = room, grid
        self.packed: npt.NDArray[np.uint16] = np.zeros((room * ROWS_PER_NODE, n_values), dtype=np.uint16)
        """The contenders of all nodes, one row each."""
        self.candidate: npt.NDArray[np.uint16] = np.zeros(room * ROWS_PER_NODE, dtype=np.uint16)
        """Which candidate a row is."""
        self.row_start: npt.NDArray[np.int64] = np.zeros(room, dtype=np.int64)
        self.row_count: Integers = np.zeros(room, dtype=np.int32)
        """0: the node is not described yet."""
        self.infeasible: npt.NDArray[np.bool_] = np.zeros((room, n_candidates), dtype=np.bool_)
        """Candidates that are known to be infeasible in a node."""
        self.digest: npt.NDArray[np.int64] = np.zeros(room, dtype=np.int64)
        """Of the whole planning state."""
        self.parent: Integers = np.zeros(room, dtype=np.int32)
        self.decision: Integers = np.zeros(room, dtype=np.int32)
        """The candidate that led from the parent to this node."""
        self.first_child: Integers = np.zeros(room, dtype=np.int32)
        self.next_sibling: Integers = np.zeros(room, dtype=np.int32)
        self.leaf: Integers = np.zeros(room, dtype=np.int32)
        """The number of the run that ended here; NONE where none did."""
        self.beside_start: Integers = np.zeros(room, dtype=np.int32)
        self.beside_count: Integers = np.zeros(room, dtype=np.int32)
        self.places: Integers = np.zeros(room * BESIDE_PER_NODE, dtype=np.int32)
        self.values: Floats = np.zeros(room * BESIDE_PER_NODE)
        self.count = self.rows = self.beside = 0
        self.add(NONE, NONE)

    @property
    def bytes(self) -> int:
        """Memory in use."""
        per_row = self.packed[0].nbytes + self.candidate.itemsize
        per_beside = self.places.itemsize + self.values.itemsize
        rest = (self.row_start, self.row_count, self.infeasible, self.digest, self.parent, self.decision, self.first_child)
        per_node = sum(array[0].nbytes for array in (*rest, self.next_sibling, self.leaf, self.beside_start, self.beside_count))
        return self.count * per_node + self.rows * per_row + self.beside * per_beside

    def has_room(self, nodes: int) -> bool:
        """Whether so many more fit, if their contenders are as many as a state can have."""
        most = nodes * self.infeasible.shape[1]
        return (
            self.room - self.count >= nodes
            and len(self.candidate) - self.rows >= min(most, len(self.candidate) // 10)
            and len(self.places) - self.beside >= len(self.places) // 10
        )

    def add(self, parent: int, decision: int) -> int:
        """A new node, not described yet. Raises IndexError where there is no room."""
        node = self.count
        self.parent[node], self.decision[node] = parent, decision
        self.first_child[node] = self.next_sibling[node] = self.leaf[node] = NONE
        self.row_count[node] = 0
        self.infeasible[node] = False
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

    def describe(self, node: int, candidates: npt.NDArray[np.int64], features: Floats, digest: int) -> bool:
        """Keeps the contenders of a state, shape (n,), with their features, shape (n, n_values), in place of what was kept; False where
        there is no room."""
        start, stop = self.rows, self.rows + len(candidates)
        if stop > len(self.candidate):
            return False
        places, values = self.places[self.beside :], self.values[self.beside :]
        count = pack(features, 1.0 / self.grid, self.packed[start:stop], places, values)
        if count < 0:
            return False
        self.candidate[start:stop] = candidates
        self.row_start[node], self.row_count[node] = start, len(candidates)
        self.beside_start[node], self.beside_count[node] = self.beside, count
        self.digest[node] = digest
        self.rows, self.beside = stop, self.beside + count
        return True

    def contenders(self, node: int) -> tuple[npt.NDArray[np.uint16], Floats]:
        """The contenders of a described node, shape (n,), and their features, shape (n, n_values)."""
        start, stop = self.row_start[node], self.row_start[node] + self.row_count[node]
        found = np.empty((stop - start, self.packed.shape[1]))
        beside = slice(self.beside_start[node], self.beside_start[node] + self.beside_count[node])
        unpack(self.packed[start:stop], self.grid, self.places[beside], self.values[beside], found)
        return self.candidate[start:stop], found

    def keep(self, wanted: npt.NDArray[np.bool_]) -> Integers:
        """Forgets the nodes that are not `wanted`, shape (count,): with a node all its ancestors must be. Gives the new number of each
        old node, NONE for those that are gone."""
        old = np.flatnonzero(wanted).astype(np.int32)
        number = np.full(self.count, NONE, dtype=np.int32)
        number[old] = np.arange(len(old), dtype=np.int32)
        parents = self.parent[old]
        self._move_rows(old)
        for array in (self.infeasible, self.digest, self.decision, self.leaf):
            array[: len(old)] = array[old]
        self.count = len(old)
        self.parent[: len(old)] = np.where(parents == NONE, NONE, number[parents])
        self.first_child[: len(old)] = self.next_sibling[: len(old)] = NONE
        for node in range(1, len(old)):
            parent = self.parent[node]
            self.next_sibling[node], self.first_child[parent] = self.first_child[parent], node
        return number

    def _move_rows(self, old: Integers) -> None:
        """In the order in which they lie, so that none is overwritten before it was moved."""
        rows, beside = 0, 0
        starts, counts = self.row_start[old], self.row_count[old]
        beside_starts, beside_counts = self.beside_start[old], self.beside_count[old]
        for place in np.argsort(starts, kind="stable").tolist():
            start, count = int(starts[place]), int(counts[place])
            if not count:
                continue
            self.packed[rows : rows + count] = self.packed[start : start + count].copy()
            self.candidate[rows : rows + count] = self.candidate[start : start + count].copy()
            starts[place] = rows
            rows += count
            start, count = int(beside_starts[place]), int(beside_counts[place])
            self.places[beside : beside + count] = self.places[start : start + count].copy()
            self.values[beside : beside + count] = self.values[start : start + count].copy()
            beside_starts[place] = beside
            beside += count
        n = len(old)
        self.row_start[:n], self.row_count[:n] = starts, counts
        self.beside_start[:n], self.beside_count[:n] = beside_starts, beside_counts
        self.rows, self.beside = rows, beside


def walk(nodes: Nodes, costs: Callable[[npt.NDArray[np.uint16], Floats], Floats]) -> int:
    """`ports.CertifiablePlanner.walk` for planners without a compiled one; `costs` gives the costs of contenders, shape (n,), from their
    numbers and features, by the very arithmetic that plans.

    Ties go to the lowest candidate.
    """
    node = 0
    while nodes.row_count[node]:
        candidates, features = nodes.contenders(node)
        found = costs(candidates, features)
        known = nodes.infeasible[node]
        allowed = found if known.all() else np.where(known[candidates], np.inf, found)
        child = nodes.child(node, int(candidates[np.argmin(allowed)]))
        if child == NONE:
            return node
        node = child
    return node

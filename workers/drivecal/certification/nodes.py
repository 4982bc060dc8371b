"""Planning states as nodes of a trie, stored compactly: what decides in them, and where each decision leads.

A driving function that can be certified decides by the lowest cost over candidates, with features that do not depend on any parameter.
A node keeps the features of one planning state as whole multiples of the function's `grid`, two bytes each; the few that do not fit into
two bytes are kept beside as they are. Nothing is rounded: what comes out is bit for bit what went in.
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
BESIDE_PER_NODE = 32
"""Room for them, on average."""


@compiled
def pack(features: Any, scale: float, packed: Any, places: Any, values: Any) -> int:
    """Writes `features`, shape (n,), as multiples of 1 / `scale`. Those that are none go to `places` and `values`: how many, or -1 where
    these have too little room."""
    beside = 0
    for place in range(len(features)):
        value = features[place]
        multiple = value * scale
        if 0.0 <= multiple < BESIDE and multiple == np.floor(multiple):
            packed[place] = np.uint16(multiple)
        else:
            if beside == len(places):
                return -1
            packed[place] = BESIDE
            places[beside] = place
            values[beside] = value
            beside += 1
    return beside


@compiled
def unpack(packed: Any, grid: float, places: Any, values: Any, features: Any) -> None:
    """The inverse of `pack`; `grid` is 1 / `scale`, both powers of two. A zero comes back without its sign."""
    for place in range(len(features)):
        features[place] = packed[place] * grid
    for index in range(len(places)):
        features[places[index]] = values[index]


class Nodes:
    """One row per node in arrays of fixed room; row 0 is the state in which every run begins. A child's number is larger than its parent's.

    The room is virtual memory until rows are written.
    """

    def __init__(self, n_features: int, n_candidates: int, grid: float, room: int) -> None:
        """`n_features` per planning state, `n_candidates` to decide among; `grid`: a power of two that most features are multiples of;
        `room`: nodes."""
        self.room, self.grid = room, grid
        self.packed: npt.NDArray[np.uint16] = np.zeros((room, n_features), dtype=np.uint16)
        self.infeasible: npt.NDArray[np.bool_] = np.zeros((room, n_candidates), dtype=np.bool_)
        """Candidates that are known to be infeasible in a node."""
        self.described: npt.NDArray[np.bool_] = np.zeros(room, dtype=np.bool_)
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
        self.count = 0
        self.beside = 0
        self.add(NONE, NONE)

    @property
    def bytes_per_node(self) -> int:
        """Memory of one node, the room beside it included."""
        arrays = [array for array in vars(self).values() if isinstance(array, np.ndarray)]
        return sum(array.nbytes for array in arrays) // self.room

    @property
    def full(self) -> bool:
        """Whether no further node fits."""
        return self.count == self.room

    def add(self, parent: int, decision: int) -> int:
        """A new node, not described yet. Raises IndexError where there is no room."""
        node = self.count
        self.parent[node], self.decision[node] = parent, decision
        self.first_child[node] = self.next_sibling[node] = self.leaf[node] = NONE
        self.described[node] = False
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

    def describe(self, node: int, features: Floats) -> bool:
        """Keeps the features of a node, shape (n_features,); False where there is no room for what does not fit into two bytes."""
        places, values = self.places[self.beside :], self.values[self.beside :]
        count = pack(features, 1.0 / self.grid, self.packed[node], places, values)
        if count < 0:
            return False
        self.beside_start[node], self.beside_count[node] = self.beside, count
        self.beside += count
        self.described[node] = True
        return True

    def features(self, node: int) -> Floats:
        """The features of a described node, shape (n_features,)."""
        found = np.empty(self.packed.shape[1])
        beside = slice(self.beside_start[node], self.beside_start[node] + self.beside_count[node])
        unpack(self.packed[node], self.grid, self.places[beside], self.values[beside], found)
        return found

    def keep(self, wanted: npt.NDArray[np.bool_]) -> npt.NDArray[np.int32]:
        """Forgets the nodes that are not `wanted`, shape (count,): with a node all its ancestors must be. Gives the new number of each
        old node, NONE for those that are gone."""
        old = np.flatnonzero(wanted).astype(np.int32)
        number = np.full(self.count, NONE, dtype=np.int32)
        number[old] = np.arange(len(old), dtype=np.int32)
        parents, count = self.parent[old], 0
        for new, before in enumerate(old.tolist()):  # rows only ever move down, so none is overwritten before it was moved
            start, size = int(self.beside_start[before]), int(self.beside_count[before]) if self.described[before] else 0
            self.places[count : count + size] = self.places[start : start + size].copy()
            self.values[count : count + size] = self.values[start : start + size].copy()
            self.beside_start[new], self.beside_count[new] = count, size
            count += size
            for rows in (self.packed, self.infeasible, self.described, self.decision, self.leaf):
                rows[new] = rows[before]
        self.count, self.beside = len(old), count
        self.parent[: len(old)] = np.where(parents == NONE, NONE, number[parents])
        self.first_child[: len(old)] = NONE
        for node in range(1, len(old)):
            parent = self.parent[node]
            self.next_sibling[node], self.first_child[parent] = self.first_child[parent], node
        return number


def walk(nodes: Nodes, costs: Callable[[Floats], Floats]) -> int:
    """`ports.CertifiablePlanner.walk` for planners without a compiled one; `costs` gives the cost of every candidate, shape
    (n_candidates,), from the features of a planning state, by the very arithmetic that plans.

    Ties go to the lowest index.
    """
    node = 0
    while nodes.described[node]:
        found = costs(nodes.features(node))
        allowed = np.where(nodes.infeasible[node], np.inf, found)
        chosen = int(np.argmin(allowed if np.isfinite(allowed).any() else found))
        child = nodes.child(node, chosen)
        if child == NONE:
            return node
        node = child
    return node

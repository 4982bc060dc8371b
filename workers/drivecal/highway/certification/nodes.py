"""Planning states as nodes of a trie, stored compactly with their contenders and the successor of each decision.

A certifiable driving function chooses the candidate of lowest cost, with features that do not depend on any parameter. A node of a new
state stores the inputs of these features, some dozens of numbers. A node that is queried repeatedly is described: it stores the features
of its contenders, i.e. of the candidates that could win under some allowed parameters. Features are stored as whole multiples of the
function's `grid`, two bytes each; the few that do not fit are stored beside, unpacked. Nothing is rounded: unpacked features equal
the original bit for bit.
"""

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from drivecal.highway.certification.kernels import NONE, count_beside, digest, follow, link, move, pack, unpack

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int32]

INFEASIBLE = 32768
"""Added to the number of a candidate that is known to be infeasible."""


class Nodes:
    """Growing arrays with one row per node; row 0 is the initial state of all runs. A child's number is larger than its parent's."""

    def __init__(self, n_values: int, n_candidates: int, grid: float) -> None:
        """Creates a trie with the root only. Raises ValueError for too many candidates.

        `n_values`: numbers that determine the cost of one of `n_candidates`; `grid`: a power of two; most of these numbers are multiples
        of it.
        """
        if n_candidates > INFEASIBLE:
            raise ValueError(f"{n_candidates} candidates are too many to be certified; at most {INFEASIBLE}")
        self.grid, self.n_candidates = grid, n_candidates
        self.packed: npt.NDArray[np.uint16] = np.zeros((0, n_values), dtype=np.uint16)
        """Contenders of all nodes, one row each."""
        self.candidate: npt.NDArray[np.uint16] = np.zeros(0, dtype=np.uint16)
        """Candidate of each row, plus INFEASIBLE if it is known to be infeasible."""
        self.row_start: npt.NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self.row_count: Integers = np.zeros(0, dtype=np.int32)
        """Number of contenders; 0 if the node is not described yet."""
        self.digest: npt.NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        """Digest of the planning state; 0 if it is unknown."""
        self.state: Integers = np.zeros(0, dtype=np.int32)
        """Row of the planning state in `states`; NONE if the node is described or its state unknown."""
        self.decided: Integers = np.zeros(0, dtype=np.int32)
        """Number of decisions that the planner has made in the state for certificates."""
        self.visited: npt.NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        """Time of the last visit of the node or a node below it."""
        self.parent: Integers = np.zeros(0, dtype=np.int32)
        self.decision: Integers = np.zeros(0, dtype=np.int32)
        """Candidate that led from the parent to this node."""
        self.first_child: Integers = np.zeros(0, dtype=np.int32)
        self.next_sibling: Integers = np.zeros(0, dtype=np.int32)
        self.leaf: Integers = np.zeros(0, dtype=np.int32)
        """Number of the run that ended here; NONE without such a run."""
        self.beside_start: npt.NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self.beside_count: Integers = np.zeros(0, dtype=np.int32)
        self.places: Integers = np.zeros(0, dtype=np.int32)
        self.values: Floats = np.zeros(0)
        self.states: Floats = np.zeros((0, 0))
        self._free: list[int] = []
        """Unused rows of `states`."""
        self.count = self.rows = self.beside = self.state_rows = 0
        self._add(np.array([NONE]), np.array([NONE]))
        self._per_node = sum(getattr(self, name).itemsize for name in _NODE_ARRAYS)

    @property
    def bytes(self) -> int:
        """Memory in use."""
        per_row = self.packed.itemsize * (self.packed.shape[1] + 1)
        per_state = self.states.itemsize * self.states.shape[1]
        beside = self.beside * (self.places.itemsize + self.values.itemsize)
        return self.count * self._per_node + self.rows * per_row + self.state_rows * per_state + beside

    def extend(self, decisions: Sequence[int], states: Floats) -> tuple[int, int | None]:
        """Adds a run: its `decisions`, shape (n,), and the states in which they were made, shape (n, n_state).

        Returns the node at the end of the run and None. If equal decisions led to another state than before, adds nothing and returns the
        number of that decision as the second value.
        """
        sequence, digests = np.array(decisions, dtype=np.int64), np.empty(len(decisions), dtype=np.int64)
        digest(states, digests)
        node, depth, same = follow(sequence, digests, self.first_child, self.next_sibling, self.decision, self.digest)
        if not same:
            return node, depth
        if depth == len(sequence):
            return node, None
        if not self.digest[node]:
            self._store_states(np.array([node]), states[depth : depth + 1], digests[depth : depth + 1])
        first, end = self.count, self.count + len(sequence) - depth - 1
        self._add(np.array([node, *range(first, end)]), sequence[depth:])
        self._store_states(np.arange(first, end), states[depth + 1 :], digests[depth + 1 :])
        return end, None

    def _add(self, parents: npt.NDArray[np.int64], decisions: npt.NDArray[np.int64]) -> None:
        """Adds empty nodes; each except the first is the only child of the one before."""
        start, stop = self.count, self.count + len(parents)
        self._grow(_NODE_ARRAYS, stop)
        new = slice(start, stop)
        self.parent[new], self.decision[new] = parents, decisions
        for name in ("first_child", "next_sibling", "leaf", "state"):
            getattr(self, name)[new] = NONE
        for name in ("visited", "digest", "decided", "row_start", "row_count", "beside_start", "beside_count"):
            getattr(self, name)[new] = 0
        self.first_child[start : stop - 1] = np.arange(start + 1, stop)
        parent = int(parents[0])
        if parent != NONE:
            self.next_sibling[start], self.first_child[parent] = self.first_child[parent], start
        self.count = stop

    def _store_states(self, nodes: npt.NDArray[np.int64], states: Floats, digests: npt.NDArray[np.int64]) -> None:
        """Stores the planning states of nodes without a known state."""
        recycled = self._free[len(self._free) - min(len(nodes), len(self._free)) :]
        del self._free[len(self._free) - len(recycled) :]
        added = len(nodes) - len(recycled)
        rows = np.array([*recycled, *range(self.state_rows, self.state_rows + added)], dtype=np.int32)
        self.state_rows += added
        if not self.states.shape[1]:
            self.states = np.zeros((0, states.shape[1]))
        self._grow(("states",), self.state_rows)
        self.states[rows] = states
        self.state[nodes], self.digest[nodes] = rows, digests

    def child(self, node: int, chosen: int) -> int:
        """Returns the node that `chosen` leads to from `node`; NONE if it was never driven."""
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
        """Replaces the content of a node by the contenders of its state, shape (n,), and their features, shape (n, n_values).

        `infeasible`, shape (n_candidates,): candidates known to be infeasible.
        """
        if self.state[node] != NONE:
            self._free.append(int(self.state[node]))
            self.state[node] = NONE
        start, stop = self.rows, self.rows + len(candidates)
        added = count_beside(features, 1.0 / self.grid)
        self._grow(_ROW_ARRAYS, stop)
        self._grow(_BESIDE_ARRAYS, self.beside + added)
        places, values = self.places[self.beside :], self.values[self.beside :]
        pack(features, 1.0 / self.grid, self.packed[start:stop], places, values)
        self.candidate[start:stop] = candidates + INFEASIBLE * infeasible[candidates]
        self.row_start[node], self.row_count[node] = start, len(candidates)
        self.beside_start[node], self.beside_count[node] = self.beside, added
        self.rows, self.beside = stop, self.beside + added

    def contenders(self, node: int) -> tuple[npt.NDArray[np.uint16], npt.NDArray[np.bool_], Floats]:
        """Returns the contenders of a described node, shape (n,), a mask of the infeasible ones, and features, shape (n, n_values)."""
        start, stop = self.row_start[node], self.row_start[node] + self.row_count[node]
        features = np.empty((stop - start, self.packed.shape[1]))
        beside = slice(self.beside_start[node], self.beside_start[node] + self.beside_count[node])
        unpack(self.packed[start:stop], self.grid, self.places[beside], self.values[beside], features)
        candidates = self.candidate[start:stop]
        return candidates % INFEASIBLE, candidates >= INFEASIBLE, features

    def infeasible(self, node: int) -> npt.NDArray[np.bool_]:
        """Returns the mask of candidates that are contenders of a node and known to be infeasible, shape (n_candidates,)."""
        candidates = self.candidate[self.row_start[node] : self.row_start[node] + self.row_count[node]]
        mask = np.zeros(self.n_candidates, dtype=np.bool_)
        mask[candidates[candidates >= INFEASIBLE] - INFEASIBLE] = True
        return mask

    def keep(self, retained: npt.NDArray[np.bool_]) -> None:
        """Forgets all nodes that are not `retained`, shape (count,), and frees their memory.

        All ancestors of a retained node must be retained. The nodes get new numbers in the order of the old ones.
        """
        old = np.flatnonzero(retained)
        number = np.full(self.count, NONE, dtype=np.int32)
        number[old] = np.arange(len(old), dtype=np.int32)
        for name in _NODE_ARRAYS:
            setattr(self, name, getattr(self, name)[old])
        self.parent[1:] = number[self.parent[1:]]
        link(self.parent, self.first_child, self.next_sibling)
        self.count = len(old)
        with_state = np.flatnonzero(self.state != NONE)
        self.states, self._free, self.state_rows = self.states[self.state[with_state]], [], len(with_state)
        self.state[with_state] = np.arange(len(with_state), dtype=np.int32)
        self._compact(_ROW_ARRAYS, "row_start", self.row_count)
        self._compact(_BESIDE_ARRAYS, "beside_start", self.beside_count)
        self.rows, self.beside = len(self.candidate), len(self.places)

    def _compact(self, names: tuple[str, ...], starts: str, counts: Integers) -> None:
        old_starts = getattr(self, starts)
        for name in names:
            array = getattr(self, name)
            compacted = np.empty((int(counts.sum()), *array.shape[1:]), dtype=array.dtype)
            new_starts = old_starts.copy()
            move(new_starts, counts, *(matrix if matrix.ndim == 2 else matrix[:, None] for matrix in (array, compacted)))
            setattr(self, name, compacted)
        setattr(self, starts, new_starts)

    def _grow(self, names: tuple[str, ...], length: int) -> None:
        if length <= len(getattr(self, names[0])):
            return
        for name in names:
            array = getattr(self, name)
            # In place: large blocks are remapped instead of copied, so that two copies never have to fit into memory.
            array.resize((max(64, length + length // 8), *array.shape[1:]), refcheck=False)


_NODE_ARRAYS = (
    "row_start",
    "row_count",
    "digest",
    "state",
    "decided",
    "visited",
    "parent",
    "decision",
    "first_child",
    "next_sibling",
    "leaf",
    "beside_start",
    "beside_count",
)
_ROW_ARRAYS = ("packed", "candidate")
_BESIDE_ARRAYS = ("places", "values")


def walk(nodes: Nodes, node: int, costs: Callable[[npt.NDArray[np.uint16], Floats], Floats]) -> int:
    """Implements `ports.CertifiablePlanner.walk` for planners without compiled code. Ties go to the lowest candidate.

    `costs` returns the costs of contenders, shape (n,), from their numbers and features, by the same arithmetic as planning.
    """
    while nodes.row_count[node]:
        candidates, infeasible, features = nodes.contenders(node)
        values = costs(candidates, features)
        allowed = values if infeasible.all() else np.where(infeasible, np.inf, values)
        child = nodes.child(node, int(candidates[np.argmin(allowed)]))
        if child == NONE:
            return node
        node = child
    return node

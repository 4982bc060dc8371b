"""Compiled arithmetic of certificates: packing of features, selection of contenders, and traversal of the trie."""

from typing import Any

import numpy as np

from drivecal.highway.compilation import compiled_with

compiled = compiled_with(error_model="numpy")

NONE = -1
BESIDE = 65535
"""Marks a feature that does not fit into two bytes and is stored beside, unpacked."""


@compiled
def count_beside(features: Any, scale: float) -> int:
    """Counts the `features`, shape (n, k), that are not multiples of 1 / `scale` or do not fit into two bytes."""
    beside = 0
    for value in features.ravel():
        multiple = value * scale
        if not (0.0 <= multiple < BESIDE and multiple == np.floor(multiple)):
            beside += 1
    return beside


@compiled
def pack(features: Any, scale: float, packed: Any, places: Any, values: Any) -> None:
    """Writes `features`, shape (n, k), to `packed` as multiples of 1 / `scale`, and the other features to `places` and `values`."""
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
    """Inverts `pack`, except that zeros lose their sign; `grid` is 1 / `scale`, both powers of two."""
    n, k = features.shape
    for row in range(n):
        for column in range(k):
            features[row, column] = packed[row, column] * grid
    for index in range(len(places)):
        features[places[index] // k, places[index] % k] = values[index]


@compiled
def contenders(features: Any, lowest: Any, highest: Any, infeasible: Any, chosen: int, leaders: int, margin: float) -> Any:
    """Returns the candidates that could have the lowest cost under weights between `lowest` and `highest`, in ascending order.

    `features`, shape (n, n_terms): one column per weight. A candidate is excluded if, for all weights, one of `leaders` good candidates
    that are not known to be `infeasible` costs less by more than `margin`. Rounding errors must be smaller than `margin`. `chosen` always
    stays.
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
            if not gap[place] > margin or number[place] == chosen:  # a gap of NaN excludes no candidate
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
    """Marks a node and all its ancestors as visited at `clock`."""
    while node >= 0:
        visited[node] = clock
        node = parent[node]


@compiled
def decisions_to(node: int, parent: Any, decision: Any) -> Any:
    """Returns the decisions from node 0 to `node` in order, shape (n,)."""
    depth, above = 0, node
    while parent[above] >= 0:
        depth, above = depth + 1, parent[above]
    decisions = np.empty(depth, dtype=np.int64)
    while depth > 0:
        depth -= 1
        decisions[depth] = decision[node]
        node = parent[node]
    return decisions


@compiled
def move(starts: Any, counts: Any, old: Any, new: Any) -> None:
    """Copies `counts` rows of `old` from each of `starts` consecutively to `new`; overwrites `starts` with the new positions."""
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
    """Derives the children of all nodes from their parents."""
    first_child[:] = NONE
    next_sibling[:] = NONE
    for node in range(1, len(parent)):
        next_sibling[node] = first_child[parent[node]]
        first_child[parent[node]] = node


@compiled
def digest(states: Any, digests: Any) -> None:
    """Writes a non-zero digest of 63 bits of each of `states`, shape (n, k), to `digests`. Every bit counts, including signs of zeros."""
    bits = states.view(np.uint64)
    n, k = bits.shape
    lanes = np.empty(8, dtype=np.uint64)
    for row in range(n):
        lanes[:] = np.uint64(14695981039346656037)
        for index in range(k):  # eight independent lanes, so that a value need not wait for the one before
            lane = index & 7
            mixed = (lanes[lane] ^ bits[row, index]) * np.uint64(1099511628211)
            lanes[lane] = mixed ^ (mixed >> np.uint64(29))
        total = np.uint64(14695981039346656037)
        for lane in range(8):
            total = (total ^ lanes[lane]) * np.uint64(1099511628211)
            total ^= total >> np.uint64(29)
        digests[row] = np.int64((total >> np.uint64(1)) | np.uint64(1))


@compiled
def follow(
    decisions: Any, digests: Any, first_child: Any, next_sibling: Any, decision: Any, digest: Any
) -> tuple[int, int, bool]:
    """Follows a run's `decisions`, shape (n,), from node 0 through the known nodes.

    Returns the last node, the number of decisions that led to it, and whether all states up to it had the run's `digests`, shape (n,).
    """
    node = 0
    for depth in range(len(decisions)):
        if digest[node] == 0:
            return node, depth, True
        if digest[node] != digests[depth]:
            return node, depth, False
        child = first_child[node]
        while child >= 0 and decision[child] != decisions[depth]:
            child = next_sibling[child]
        if child < 0:
            return node, depth, True
        node = child
    return node, len(decisions), True

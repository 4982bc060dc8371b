"""Compiled repetition of decisions in stored planning states, for certificates.

Costs use the arithmetic of `kernel.costs_of`, operation by operation; tests compare the two. No driven decision is made here, so that the
module is not part of the planner's version. It imports neither compiled functions nor constants of the kernel, because numba's cache would
not notice edits there.

lateral (6, n_lateral), longitudinal (2, n_longitudinal), combined (7, n_longitudinal, n_lateral): features as in the kernel.
"""

from typing import Any

import numpy as np

from drivecal.highway.compilation import compiled_with

compiled = compiled_with(error_model="numpy")

INFEASIBLE = 32768
"""Same value as in `drivecal.highway.certification.nodes`."""

TERM = np.array([0, 1, 3, 5, 6, 9, 0, 1, 0, 2, 4, 7, 8, 10, 11])
"""Index of the weight of each row of `lateral`, `longitudinal` and `combined`, in this order."""


@compiled
def by_term(lateral: Any, longitudinal: Any, combined: Any, features: Any) -> None:
    """Writes the features of all candidates, added up by weight, to `features`, shape (n_candidates, 12)."""
    n_longitudinal, n_lateral = combined.shape[1], combined.shape[2]
    features[:] = 0.0
    for j in range(n_longitudinal):
        for i in range(n_lateral):
            candidate = j * n_lateral + i
            for row in range(6):
                features[candidate, TERM[row]] += lateral[row, i]
            for row in range(2):
                features[candidate, TERM[6 + row]] += longitudinal[row, j]
            for row in range(7):
                features[candidate, TERM[8 + row]] += combined[row, j, i]


@compiled
def values_of(lateral: Any, longitudinal: Any, combined: Any, candidates: Any, values: Any) -> None:
    """Writes the values that determine the costs of some candidates to `values`, shape (n, 15): rows of all three feature arrays."""
    n_lateral = combined.shape[2]
    for index in range(len(candidates)):
        j, i = candidates[index] // n_lateral, candidates[index] % n_lateral
        for row in range(6):
            values[index, row] = lateral[row, i]
        for row in range(2):
            values[index, 6 + row] = longitudinal[row, j]
        for row in range(7):
            values[index, 8 + row] = combined[row, j, i]


@compiled
def walk(
    weights: Any, node: int, grid: float, packed: Any, candidate: Any, row_start: Any, row_count: Any, beside_start: Any, beside_count: Any,
    places: Any, values: Any, first_child: Any, next_sibling: Any, decision: Any,
) -> int:  # fmt: skip
    """Repeats the decisions of `plan`, beginning at `node`, and returns the last node, see `ports.CertifiablePlanner.walk`.

    A contender's values equal those of `values_of`, its cost equals that of `costs_of`, term by term. The arrays are those of
    `drivecal.highway.certification.nodes.Nodes`.
    """
    v = np.empty(15)
    while row_count[node] > 0:
        best, lowest, best_of_all, lowest_of_all = -1, np.inf, -1, np.inf
        beside, beside_end = beside_start[node], beside_start[node] + beside_count[node]
        for index in range(row_count[node]):
            row = row_start[node] + index
            for column in range(15):
                v[column] = packed[row, column] * grid
            while beside < beside_end and places[beside] < (index + 1) * 15:
                v[places[beside] - index * 15] = values[beside]
                beside += 1
            along = weights[0] * v[6] + weights[1] * v[7]
            aside = (
                weights[0] * v[0]
                + weights[1] * v[1]
                + weights[3] * v[2]
                + weights[5] * v[3]
                + weights[6] * v[4]
                + weights[9] * v[5]
            )
            cost = (
                (along + aside)
                + weights[0] * v[8]
                + weights[2] * v[9]
                + weights[4] * v[10]
                + weights[7] * v[11]
                + weights[8] * v[12]
                + weights[10] * v[13]
                + weights[11] * v[14]
            )
            number = int(candidate[row])
            if cost < lowest_of_all:
                best_of_all, lowest_of_all = number % INFEASIBLE, cost
            if cost < lowest and number < INFEASIBLE:
                best, lowest = number, cost
        chosen = best if best >= 0 else best_of_all
        child = first_child[node]
        while child >= 0 and decision[child] != chosen:
            child = next_sibling[child]
        if child < 0:
            return node
        node = child
    return node

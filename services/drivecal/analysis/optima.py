"""Sets that share the best objective: in how many distinct regions they lie (Section IV-C)."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from drivecal.domain.rounding import SHARE
from drivecal.plugins.ports import Floats

NEIGHBOURS = 0.1
"""Root mean square distance, in shares of the parameters' ranges, up to which two sets count as neighbours; chains of neighbours make a
region. Two uniform random sets are 0.41 apart on average."""
AT_A_TIME = 256
"""Points whose distances from all others are held at a time."""


def distances(points: Floats, others: Floats) -> Floats:
    """Root mean square distance of each of `points`, shape (n, n_p), from each of `others`, shape (m, n_p): shape (n, m)."""
    squared = (points**2).sum(axis=1)[:, None] + (others**2).sum(axis=1)
    apart = np.maximum(squared - 2.0 * points @ others.T, 0.0)
    return np.asarray(np.sqrt(apart / points.shape[1]), dtype=np.float64)


def regions(points: Floats, neighbours: float = NEIGHBOURS) -> npt.NDArray[np.int64]:
    """The region of each point, shape (n,), numbered from 0 in the order of their first points: single linkage at `neighbours`.

    A region is flooded from its first point, some of its points at a time: the distances of all from all would not fit into memory
    where thousands of sets share the best objective.
    """
    numbers: npt.NDArray[np.int64] = np.full(len(points), -1, dtype=np.int64)
    left = np.arange(len(points))
    number = 0
    while left.size:
        edge, left = left[:1], left[1:]
        numbers[edge] = number
        while edge.size:
            near = (distances(points[edge[:AT_A_TIME]], points[left]) <= neighbours + SHARE).any(axis=0)
            edge, left = np.concatenate([edge[AT_A_TIME:], left[near]]), left[~near]
            numbers[edge] = number
        number += 1
    return numbers


def one_per_region_first(labels: Sequence[int], most: int) -> list[int]:
    """Positions of at most `most` points: the first of every region, then the second of every region, and so on.

    So a study of some of the best sets sees every region before it sees any of them twice.
    """
    seen: dict[int, int] = {}
    turns = []
    for position, label in enumerate(labels):
        turns.append((seen.get(label, 0), position))
        seen[label] = seen.get(label, 0) + 1
    return [position for _, position in sorted(turns)[:most]]

"""Fronts of several objectives: non-dominated points, knee, and the weights under which each point wins. Pure.

Points have shape (n, m), one row per set; higher is better in every column.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivecal.domain.rounding import levels
from drivecal.plugins.ports import Floats

MOST_EXACT = 3
"""Objectives up to which winning weights are computed."""
MOST_WINNING = 1_000
"""Sets of a front of three objectives up to which winning weights are computed: a thousand take seconds."""
FLAT = 1e-9
"""Smallest distance beyond the plane through the extremes that makes a knee, in shares of the front's ranges."""

Mask = npt.NDArray[np.bool_]


def non_dominated(points: Floats, violations: Floats | None = None) -> Mask:
    """Returns which points no other point dominates, shape (n,); equal points are all kept.

    Points with the least sum of violations, shape (n,), dominate all others, so that any feasible point dominates infeasible ones (Deb
    2002, IEEE Transactions on Evolutionary Computation 6(2), Section VI-A).
    """
    kept = np.zeros(len(points), dtype=np.bool_)
    if not len(points):
        return kept
    candidates = np.arange(len(points)) if violations is None else np.flatnonzero(levels(violations) == 0)
    distinct, places = np.unique(-points[candidates], axis=0, return_inverse=True)  # better first objectives come first
    kept[candidates] = _leading(distinct)[places.reshape(-1)]
    return kept


def _leading(distinct: Floats) -> Mask:
    """Which rows no other row dominates, lower is better; rows are distinct and in lexicographic order, so only earlier ones dominate."""
    leading = np.ones(len(distinct), dtype=np.bool_)
    if distinct.shape[1] == 1:
        leading[1:] = False
    elif distinct.shape[1] == 2:
        leading[1:] = distinct[1:, 1] < np.minimum.accumulate(distinct[:, 1])[:-1]
    else:
        front = np.empty_like(distinct)
        size = 0
        for place, row in enumerate(distinct):
            if size and (front[:size] <= row).all(axis=1).any():
                leading[place] = False
            else:
                front[size] = row
                size += 1
    return leading


def scaled(points: Floats) -> Floats:
    """Returns points in shares of the front's ranges: 0 for an objective's worst value on the front, 1 for the best, 1 if all are equal."""
    lowest, highest = points.min(axis=0), points.max(axis=0)
    span = highest - lowest
    return np.where(span > 0, (points - lowest) / np.where(span > 0, span, 1.0), 1.0)


def by_weights(points: Floats, weights: Floats) -> tuple[npt.NDArray[np.intp], Floats]:
    """Returns positions of points, the winner first, and all weighted sums of the scaled points, both of shape (n,).

    `weights` has shape (m,). Sums that differ by their rounding are equal: the earlier point comes first.
    """
    sums = scaled(points) @ (weights / weights.sum())
    return np.argsort(levels(-sums, 1.0), kind="stable"), sums


def knee(points: Floats) -> int | None:
    """Returns the position of the point that lies farthest beyond the plane through the extremes; None without one.

    The plane goes through the best value of each objective, with the others at their worst on the front (Das 1999, Structural Optimization
    18(2-3)); for two objectives that is the line through both extremes.
    """
    if not len(points) or points.shape[1] == 1:
        return None
    beyond = scaled(points).sum(axis=1) - 1.0
    varying = int((np.ptp(points, axis=0) > 0).sum())
    place = int(np.argmax(beyond))
    return place if varying > 1 and beyond[place] > points.shape[1] - varying + FLAT else None


def extremes(points: Floats) -> list[int]:
    """Returns the position of the best point of each objective; of equal ones the best in the sum of all scaled objectives."""
    sums = scaled(points).sum(axis=1)
    return [int(np.lexsort((-sums, -points[:, column]))[0]) for column in range(points.shape[1])]


@dataclass(frozen=True, slots=True)
class WinningWeights:
    """A convex region of weights: a set has the largest weighted sum of scaled objectives there. The weights add up to 1. `corners` bound
    the region, and `share` is its part of all weightings."""

    corners: tuple[tuple[float, ...], ...]
    share: float


def winning_weights(points: Floats) -> list[WinningWeights] | None:
    """Returns the winning weights of each point of a front: an interval for two objectives, a polygon for three, empty if it never wins.

    Cuts the simplex of all weights with the half plane of each other point, so the result is exact. Equal points win together. None for
    more than MOST_EXACT objectives, and for more than MOST_WINNING points of three.
    """
    if points.shape[1] > MOST_EXACT or (points.shape[1] == MOST_EXACT and len(points) > MOST_WINNING):
        return None
    shares = scaled(points)
    return [_region(shares, place) for place in range(len(points))]


def _region(shares: Floats, place: int) -> WinningWeights:
    """Cuts the simplex by the rival that is farthest ahead at one of the corners left, until none is."""
    corners = np.eye(shares.shape[1])
    whole = _size(corners)
    ahead = shares[place] - shares
    while len(corners):
        margins = (ahead @ corners.T).min(axis=1)
        rival = int(np.argmin(margins))
        if margins[rival] >= -FLAT:
            break
        corners = _cut(corners, ahead[rival])
        ahead[rival] = 0.0
    return WinningWeights(tuple(tuple(row) for row in corners.tolist()), _size(corners) / whole)


def _cut(corners: Floats, normal: Floats) -> Floats:
    """Returns a convex polygon, shape (k, m), cut to the half space on the side of `normal` (Sutherland and Hodgman 1974)."""
    sides = corners @ normal
    before, earlier = np.roll(sides, 1), np.roll(corners, 1, axis=0)
    crossed = sides * before < 0
    way = np.where(crossed, before / np.where(crossed, before - sides, 1.0), 0.0)
    both = np.stack([earlier + (corners - earlier) * way[:, None], corners], axis=1).reshape(-1, corners.shape[1])
    kept: Floats = both[np.stack([crossed, sides >= 0], axis=1).reshape(-1)]
    apart = np.abs(kept - np.roll(kept, 1, axis=0)).max(axis=1) > FLAT
    return kept[apart] if apart.any() else kept[:1]


def _size(corners: Floats) -> float:
    """Length of an interval or area of a polygon in the simplex, by the first coordinates; 1 for a single objective."""
    if corners.shape[1] == 1:
        return float(len(corners))
    if corners.shape[1] == 2:
        return float(np.ptp(corners[:, 0])) if len(corners) else 0.0
    if len(corners) < 3:
        return 0.0
    x, y = corners[:, 0], corners[:, 1]
    return float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)

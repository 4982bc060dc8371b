"""Ranks the parameter sets that were evaluated, under any weights, without a new simulation. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

EQUAL = 1e-9
"""Objectives that differ by no more than this are equal: alternatives of each other."""


@dataclass(frozen=True, slots=True)
class Scored:
    """The answer of one requested cell, of whatever outcome. `score` and `rating` are None where there is no result."""

    parameter_set: int
    """Its id in the database."""
    scenario: str
    score: int | None
    rating: float | None
    iteration: int
    individual: int


@dataclass(frozen=True, slots=True)
class Ranked:
    """A parameter set in the ranking; `iteration` and `individual` say where it was found first."""

    rank: int
    parameter_set: int
    objective: float
    rating: float
    scores: Mapping[str, int]
    iteration: int
    individual: int


def rank(cells: Sequence[Scored], weights: Mapping[str, float]) -> list[Ranked]:
    """All parameter sets with a result in every scenario of positive weight, best first.

    `weights` by scenario need not be normalised; scenarios of weight 0 and those not named take no part. Equal objectives are ordered
    by the weighted continuous rating, then by discovery.
    """
    scenarios = [name for name, weight in weights.items() if weight > 0]
    total = sum(weights[name] for name in scenarios)
    shares = np.array([weights[name] / total for name in scenarios])
    columns = {name: column for column, name in enumerate(scenarios)}
    rows: dict[int, int] = {}
    found_at: list[tuple[int, int]] = []
    for cell in cells:
        if cell.parameter_set not in rows:
            rows[cell.parameter_set] = len(rows)
            found_at.append((cell.iteration, cell.individual))
        else:
            row = rows[cell.parameter_set]
            found_at[row] = min(found_at[row], (cell.iteration, cell.individual))
    scores = np.full((len(rows), len(scenarios)), np.nan)
    ratings = np.full((len(rows), len(scenarios)), np.nan)
    for cell in cells:
        if cell.score is not None and cell.scenario in columns:
            scores[rows[cell.parameter_set], columns[cell.scenario]] = cell.score
            ratings[rows[cell.parameter_set], columns[cell.scenario]] = cell.rating
    objective, rating = weighted(scores, shares), weighted(ratings, shares)
    complete = [row for row in range(len(rows)) if not np.isnan(objective[row])]
    complete.sort(key=lambda row: (-round(float(objective[row]) / EQUAL), -rating[row], found_at[row]))
    sets = list(rows)
    return [
        Ranked(
            rank=position,
            parameter_set=sets[row],
            objective=float(objective[row]),
            rating=float(rating[row]),
            scores={name: int(scores[row, column]) for name, column in columns.items()},
            iteration=found_at[row][0],
            individual=found_at[row][1],
        )
        for position, row in enumerate(complete, start=1)
    ]


def weighted(values: npt.NDArray[np.float64], shares: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Equation 6: the sum over scenarios of w_j F_j, shape (n,), for `values` of shape (n, n_s) and weights of sum 1, shape (n_s,).

    Added in the order of the scenarios, so that equal scores give equal bits. NaN where any scenario has no result.
    """
    total = np.zeros(len(values))
    for column, share in enumerate(shares):
        total += share * values[:, column]
    return total


def alternatives(ranked: Sequence[Ranked]) -> int:
    """How many parameter sets share the best objective."""
    if not ranked:
        return 0
    return sum(1 for one in ranked if abs(one.objective - ranked[0].objective) <= EQUAL)

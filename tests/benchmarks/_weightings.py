"""Best sets for weightings of objectives: those that a multi-objective search already has, against fresh searches of one objective.

A fresh search is the genetic algorithm on the weighted sum, with as many requested sets as the multi-objective search.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import qmc

from drivecal.client.client import Client
from drivecal.contracts.campaign import Campaign
from drivecal.optimizers.built_in import GENETIC
from drivecal.optimizers.genetic import pairs_per_generation
from drivecal.plugins.ports import Floats

SHARES = (0.8, 0.7)
"""The genetic algorithm's selection and recombination."""


@dataclass(frozen=True)
class Weighted:
    """The weighted objective of the best set, higher is better: `known` of the multi-objective search, `fresh` of a search of its own.

    `tolerance`: in units of the objective. `seconds`: until the known set was there.
    """

    problem: str
    seed: int
    weights: Sequence[float]
    known: float
    fresh: float
    tolerance: float
    seconds: float

    @property
    def is_good(self) -> bool:
        """Whether the known set is at most one tolerance worse."""
        return self.known >= self.fresh - self.tolerance - 1e-9


def weightings(count: int, objectives: int) -> Floats:
    """Returns weights of sum 1 that cover all weightings evenly, shape (count, objectives)."""
    if objectives == 2:
        first = (np.arange(count) + 0.5) / count
        return np.column_stack([first, 1 - first])
    shares = -np.log1p(-qmc.Halton(objectives, scramble=False).random(count + 1)[1:])
    even: Floats = shares / shares.sum(axis=1, keepdims=True)
    return even


def iterations_for(population: int, asked: int) -> int:
    """Returns the iterations after which the genetic algorithm has asked for so many sets."""
    return 1 + round((asked - population) / pairs_per_generation(population, *SHARES))


def genetic(population: int, asked: int, seed: int) -> dict[str, Any]:
    """Returns the `optimizer` section of a fresh search."""
    return {"kind": "genetic", "population": population, "iterations": iterations_for(population, asked), "seed": seed}


def searched(worths: Callable[[Floats], Floats], n_values: Sequence[int], population: int, asked: int, seed: int) -> float:
    """Returns the best worth that a fresh search finds. `worths`: of shares of the ranges, shape (n, k)."""
    settings = GENETIC.settings.model_validate(genetic(population, asked, seed))
    sizes = np.array(n_values)
    optimizer, best = GENETIC.create(settings, sizes), -np.inf
    for _ in range(iterations_for(population, asked)):
        values = worths(optimizer.ask().population / (sizes - 1))
        optimizer.tell(values, np.zeros(len(values)))
        best = max(best, float(values.max()))
    return best


def on_functions(
    problem: str,
    costs: Callable[[Floats], Floats],
    gains: Floats,
    shape: tuple[int, int, int],
    seed: int,
    count: int,
    tolerance: float,
) -> Iterator[Weighted]:
    """Yields a comparison per weighting on a problem of formulas. `gains`: of all sets that the multi-objective search asked for;
    `shape`: variables, values of each, population."""
    variables, values, population = shape
    for weights in weightings(count, gains.shape[1]):
        begun = time.perf_counter()
        known = float((gains @ weights).max())
        seconds = time.perf_counter() - begun

        def worths(shares: Floats, weights: Floats = weights) -> Floats:
            worth: Floats = -costs(shares) @ weights
            return worth

        fresh = searched(worths, [values] * variables, population, len(gains), seed)
        yield Weighted(problem, seed, weights.tolist(), known, fresh, tolerance, seconds)


def on_server(
    client: Client, problem: str, campaign: Campaign, shares: Sequence[Mapping[str, float]], seed: int, count: int
) -> Iterator[Weighted]:
    """Yields a comparison per weighting of a campaign's objectives, each a mean of the score. `shares`: weights of each objective's
    scenarios, of sum 1."""
    optimizer = campaign.spec["optimizer"]
    population, asked = optimizer["population"], optimizer["population"] * optimizer["iterations"]
    scale = campaign.scale
    for weights in weightings(count, len(shares)):
        by_scenario = {
            name: float(weight) * share for weight, of in zip(weights, shares, strict=True) for name, share in of.items()
        }
        begun = time.perf_counter()
        known = client.solutions(campaign.id, by_scenario, limit=1).items[0].objective
        seconds = time.perf_counter() - begun
        search = {"optimizer": genetic(population, asked, seed), "weights": by_scenario, "reduction": {"mode": "exact"}}
        fresh = client.wait(client.submit(search).id)
        if fresh.best is None or fresh.state != "succeeded":
            raise RuntimeError(f"the campaign ended as {fresh.state}: {fresh.error}")
        worths = [scale.sign * value for value in (known, fresh.best.objective)]
        yield Weighted(problem, seed, weights.tolist(), worths[0], worths[1], scale.tolerance, seconds)

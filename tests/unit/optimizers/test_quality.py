"""The genetic algorithm against its floor, random search, and against pymoo's binary genetic algorithm."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pymoo.algorithms.soo.nonconvex.ga import GA
from pymoo.core.problem import Problem
from pymoo.operators.crossover.pntx import TwoPointCrossover
from pymoo.operators.mutation.bitflip import BitflipMutation
from pymoo.operators.sampling.rnd import BinaryRandomSampling
from pymoo.optimize import minimize
from scipy import stats
from tests.support.effort import tries

from drivecal.domain.parameters import Indices
from drivecal.optimizers.built_in import GENETIC, RANDOM
from drivecal.optimizers.genetic import BitEncoding
from drivecal.plugins.ports import Floats, OptimizerPlugin

SEEDS = range(30)
RUNS = tries(15, 30)
TARGET = np.array([3, 9, 14, 0, 7, 11])
PEAKS = np.array([40, 33, 180, 1500, 20, 90, 111, 700, 5, 60, 160])

ones = np.full(40, 2)
letters = np.full(6, 16)
highway = np.array([59, 201, 201, 2001, 1501, 101, 201, 2001, 101, 201, 201])


def count_of_ones(population: Indices) -> Floats:
    return np.asarray(population.sum(axis=1), dtype=np.float64)


def distance(population: Indices) -> Floats:
    return np.asarray(-np.abs(population - TARGET).sum(axis=1), dtype=np.float64)


def steps(population: Indices) -> Floats:
    """Separable, discrete like a comfort score: 0..7 for each parameter by its distance from a peak."""
    away = np.abs(population - PEAKS) / (highway - 1)
    return np.asarray(np.floor(7.999 * (1 - away) ** 3).mean(axis=1), dtype=np.float64)


def best_of(
    plugin: OptimizerPlugin, objective: Callable[[Indices], Floats], n_values: Indices, iterations: int, seed: int
) -> float:
    optimizer = plugin.create(plugin.settings(population=100, iterations=iterations, seed=seed), n_values)
    best = -np.inf
    for _ in range(iterations):
        objectives = objective(optimizer.ask().population)
        optimizer.tell(objectives, objectives)
        best = max(best, float(objectives.max()))
    return best


@pytest.mark.parametrize(
    ("objective", "n_values"), [(count_of_ones, ones), (distance, letters), (steps, highway)], ids=["ones", "letters", "steps"]
)
def test_it_beats_random_search_at_equally_many_requests(objective: Callable[[Indices], Floats], n_values: Indices) -> None:
    genetic = [best_of(GENETIC, objective, n_values, 20, seed) for seed in SEEDS]
    floor = [best_of(RANDOM, objective, n_values, 20, seed) for seed in SEEDS]
    assert stats.mannwhitneyu(genetic, floor, alternative="greater").pvalue < 1e-6


def best_of_pymoo(objective: Callable[[Indices], Floats], n_values: Indices, iterations: int, seed: int) -> float:
    encoding = BitEncoding(n_values)

    class Decoded(Problem):  # type: ignore[misc]  # pymoo ships no types
        def __init__(self) -> None:
            super().__init__(n_var=int(encoding.bits.sum()), n_obj=1, xl=0, xu=1, vtype=bool)

        def _evaluate(self, x: Any, out: dict[str, Any], *_: Any, **__: Any) -> None:
            out["F"] = -objective(encoding.indices(encoding.from_chromosomes(x.astype(np.bool_))))

    algorithm = GA(
        pop_size=100,
        n_offsprings=28,
        sampling=BinaryRandomSampling(),
        crossover=TwoPointCrossover(),
        mutation=BitflipMutation(),
        eliminate_duplicates=True,
    )
    return -float(minimize(Decoded(), algorithm, ("n_gen", iterations), seed=seed, verbose=False).F[0])


@pytest.mark.faults
@pytest.mark.parametrize(
    ("objective", "n_values", "optimum"), [(count_of_ones, ones, 40.0), (distance, letters, 0.0)], ids=["ones", "letters"]
)
def test_it_finds_the_optimum_about_as_often_as_pymoos_genetic_algorithm(
    objective: Callable[[Indices], Floats], n_values: Indices, optimum: float
) -> None:
    """Same population, children per generation and bits; pymoo adds a tournament and forbids duplicates. Seen: 21 and 25 of 30 (ours),
    24 and 22 of 30 (pymoo). The test fails where one is better than chance explains."""
    ours = sum(best_of(GENETIC, objective, n_values, 40, seed) == optimum for seed in range(RUNS))
    theirs = sum(best_of_pymoo(objective, n_values, 40, seed) == optimum for seed in range(RUNS))
    assert ours >= RUNS / 2
    assert stats.fisher_exact(np.array([[ours, RUNS - ours], [theirs, RUNS - theirs]])).pvalue > 0.01

"""The genetic algorithm against its floor, random search."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats

from drivecal.domain.parameters import Indices
from drivecal.optimizers.built_in import GENETIC, RANDOM
from drivecal.plugins.ports import Floats, OptimizerPlugin

SEEDS = range(30)
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

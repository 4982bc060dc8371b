"""NSGA-II and NSGA-III with several objectives and violations, behind the port."""

from __future__ import annotations

import json

import numpy as np
import pytest
from tests.support.effort import tries

from drivecal.analysis.front import hypervolume
from drivecal.domain.parameters import Indices
from drivecal.optimizers.built_in import RANDOM
from drivecal.optimizers.nsga import NSGA2, NSGA3, directions
from drivecal.plugins.ports import DeclaringOptimizerPlugin, Floats, Optimizer

GRID = np.array([101] * 5)
every = pytest.mark.parametrize("plugin", [NSGA2, NSGA3], ids=["nsga2", "nsga3"])


def zdt1(population: Indices) -> Floats:
    shares = population / (GRID - 1)
    slope = 1 + 9 * shares[:, 1:].mean(axis=1)
    return -np.column_stack([shares[:, 0], slope * (1 - np.sqrt(shares[:, 0] / slope))])


def bounded(population: Indices) -> tuple[Floats, Floats]:
    """Nothing below 0.2 of the first parameter is feasible, and every seventh set has no result."""
    missing = population[:, 1] % 7 == 0
    violations = np.where(missing, np.nan, np.maximum(0.0, 0.2 - population[:, 0] / 100))
    return np.where(missing[:, np.newaxis], np.nan, zdt1(population)), violations


def drive(optimizer: Optimizer, iterations: int) -> list[Indices]:
    populations = []
    for _ in range(iterations):
        populations.append(optimizer.ask().population)
        optimizer.tell(*bounded(populations[-1]))
    return populations


@every
@pytest.mark.parametrize("asked", [False, True])
def test_a_resumed_search_of_several_objectives_equals_an_uninterrupted_one(
    plugin: DeclaringOptimizerPlugin, asked: bool
) -> None:
    settings = plugin.settings(population=20)
    whole = drive(plugin.create(settings, GRID), 8)
    first = plugin.create(settings, GRID)
    begun = drive(first, 4)
    if asked:
        first.ask()
    second = plugin.restore(settings, GRID, json.loads(json.dumps(first.state(), allow_nan=False)))
    assert all(np.array_equal(a, b) for a, b in zip(begun + drive(second, 4), whole, strict=True))


@every
def test_individuals_get_feasible(plugin: DeclaringOptimizerPlugin) -> None:
    populations = drive(plugin.create(plugin.settings(population=20), GRID), 15)
    assert (populations[0][:, 0] < 20).any()
    assert (populations[-1][:, 0] >= 20).mean() > 0.7


@every
def test_fronts_are_larger_than_those_of_random_search(plugin: DeclaringOptimizerPlugin) -> None:
    def volume(which: DeclaringOptimizerPlugin, seed: int) -> float:
        optimizer = which.create(which.settings(population=20, seed=seed), GRID)
        found = []
        for _ in range(15):
            found.append(zdt1(optimizer.ask().population))
            several = which is not RANDOM
            optimizer.tell(found[-1] if several else found[-1].sum(axis=1), np.zeros(20))
        return hypervolume(np.concatenate(found), np.array([-1.0, -10.0])) or 0.0

    for seed in range(tries(2, 5)):
        assert volume(plugin, seed) > volume(RANDOM, seed)


@every
def test_a_space_that_is_used_up_proposes_nothing_new(plugin: DeclaringOptimizerPlugin) -> None:
    optimizer = plugin.create(plugin.settings(population=10), np.array([2, 2]))
    for iteration in range(4):
        proposal = optimizer.ask()
        assert iteration == 0 or not proposal.changed.any()
        optimizer.tell(-proposal.population.astype(np.float64), np.zeros(10))


@every
def test_answers_that_do_not_fit_are_refused(plugin: DeclaringOptimizerPlugin) -> None:
    optimizer = plugin.create(plugin.settings(population=20), GRID)
    optimizer.ask()
    for objectives, violations in (((19, 2), 20), ((20, 2), 19)):
        with pytest.raises(ValueError, match="20"):
            optimizer.tell(np.zeros(objectives), np.zeros(violations))


@pytest.mark.parametrize(("population", "objectives", "count"), [(20, 1, 1), (20, 2, 20), (20, 3, 15), (100, 3, 91), (3, 4, 4)])
def test_reference_directions_fit_into_the_population(population: int, objectives: int, count: int) -> None:
    rows = directions(population, objectives)
    assert rows.shape == (count, objectives)
    assert rows.sum(axis=1) == pytest.approx(np.ones(count))

"""Optimizers of several objectives with violations, behind the port: Optuna's samplers."""

import json
from typing import Any

import moocore
import numpy as np
import pytest
from tests.support.effort import tries

from drivecal.domain.parameters import Indices
from drivecal.optimizers.built_in import RANDOM
from drivecal.optimizers.optuna_samplers import OPTUNA
from drivecal.plugins.ports import DeclaringOptimizerPlugin, Floats, Optimizer

GRID = np.array([101] * 5)
SEARCHES: dict[str, tuple[DeclaringOptimizerPlugin, dict[str, Any]]] = {
    "nsga2": (OPTUNA, {"population": 20, "iterations": 15, "sampler": "nsga2"}),
    "tpe": (OPTUNA, {"population": 12, "iterations": 9, "sampler": "tpe"}),  # its models take long, and learn from few runs
}
every = pytest.mark.parametrize(("plugin", "chosen"), SEARCHES.values(), ids=SEARCHES)


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


@pytest.mark.slow("tpe")
@every
@pytest.mark.parametrize("asked", [False, True])
def test_a_resumed_search_of_several_objectives_equals_an_uninterrupted_one(
    plugin: DeclaringOptimizerPlugin, chosen: dict[str, Any], asked: bool
) -> None:
    settings = plugin.settings(**chosen)
    iterations = 4
    whole = drive(plugin.create(settings, GRID), iterations)
    first = plugin.create(settings, GRID)
    begun = drive(first, iterations // 2)
    if asked:
        first.ask()
    second = plugin.restore(settings, GRID, json.loads(json.dumps(first.state(), allow_nan=False)))
    assert all(np.array_equal(a, b) for a, b in zip(begun + drive(second, iterations - iterations // 2), whole, strict=True))


@pytest.mark.slow("tpe")
@every
def test_individuals_get_feasible(plugin: DeclaringOptimizerPlugin, chosen: dict[str, Any]) -> None:
    populations = drive(plugin.create(plugin.settings(**chosen), GRID), chosen["iterations"])
    assert (populations[0][:, 0] < 20).any()
    assert (populations[-1][:, 0] >= 20).mean() > 0.7


@pytest.mark.slow("tpe")
@every
def test_fronts_are_larger_than_those_of_random_search(plugin: DeclaringOptimizerPlugin, chosen: dict[str, Any]) -> None:
    def volume(which: DeclaringOptimizerPlugin, seed: int, **settings: Any) -> float:
        optimizer = which.create(which.settings(**settings, seed=seed), GRID)
        result = []
        for _ in range(chosen["iterations"]):
            result.append(zdt1(optimizer.ask().population))
            several = which is not RANDOM
            optimizer.tell(result[-1] if several else result[-1].sum(axis=1), np.zeros(chosen["population"]))
        return float(moocore.hypervolume(-np.concatenate(result), ref=np.array([1.0, 10.0])))

    for seed in range(tries(2, 5)):
        assert volume(plugin, seed, **chosen) > volume(RANDOM, seed, population=chosen["population"])


@every
def test_answers_that_do_not_fit_are_refused(plugin: DeclaringOptimizerPlugin, chosen: dict[str, Any]) -> None:
    optimizer = plugin.create(plugin.settings(**chosen), GRID)
    size = len(optimizer.ask().population)
    for objectives, violations in (((size - 1, 2), size), ((size, 2), size - 1)):
        with pytest.raises(ValueError, match=str(size)):
            optimizer.tell(np.zeros(objectives), np.zeros(violations))

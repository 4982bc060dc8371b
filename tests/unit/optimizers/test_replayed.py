"""Optimizers of other libraries behind the port: deterministic, resumable, and better than chance."""

import importlib
import json
import sys
from typing import Any

import numpy as np
import pytest

from drivecal.domain.errors import InvalidInputError, ReplayError
from drivecal.domain.parameters import Indices
from drivecal.optimizers import optuna_samplers
from drivecal.optimizers.cma_es import CMA_ES
from drivecal.optimizers.replayed import Replayed
from drivecal.plugins import registry
from drivecal.plugins.ports import Floats, Optimizer, OptimizerPlugin

GRID = np.array([59, 201, 16, 2001])
OPTUNA = optuna_samplers.OPTUNA
CASES: list[tuple[OptimizerPlugin, dict[str, Any]]] = [
    (CMA_ES, {}),
    *((OPTUNA, {"sampler": sampler}) for sampler in ("tpe", "nsga2", "random")),
]
every = pytest.mark.parametrize(("plugin", "chosen"), CASES, ids=["cma_es", "tpe", "nsga2", "random"])


def bowl(population: Indices) -> tuple[Floats, Floats]:
    rating = -((population / (GRID - 1) - 0.3) ** 2).sum(axis=1)
    return np.round(4 * rating) / 4, rating


def patchy(population: Indices) -> tuple[Floats, Floats]:
    objectives, ratings = bowl(population)
    missing = population[:, 0] % 5 == 0
    return np.where(missing, np.nan, objectives), np.where(missing, np.nan, ratings)


def drive(optimizer: Optimizer, iterations: int) -> list[Indices]:
    result = []
    for _ in range(iterations):
        result.append(optimizer.ask().population)
        optimizer.tell(*patchy(result[-1]))
    return result


def create(plugin: OptimizerPlugin, chosen: dict[str, Any], **more: Any) -> Optimizer:
    return plugin.create(plugin.settings(**({"population": 12} | chosen | more)), GRID)


def test_populations_of_optunas_nsga2_descend_from_the_start_and_from_those_with_failed_runs() -> None:
    """A population of equal sets has children that share values with it; random ones would not on this grid."""
    parents = np.tile([30, 100, 8, 1000], (20, 1))
    settings = optuna_samplers.OptunaSettings(population=20, sampler="nsga2")
    engine = optuna_samplers.OptunaEngine(settings, GRID, ["grid"] * 4)
    ratings = np.arange(20, dtype=np.float64)
    engine.learn(parents, ratings, ratings)
    for _ in range(3):
        children = engine.propose()
        assert (children == parents[0]).mean() > 0.4
        answers = np.where(np.arange(20) == 3, np.nan, ratings)  # one run fails
        engine.learn(children, answers - 100, answers)


@pytest.mark.slow("False", "tpe")
@every
@pytest.mark.parametrize("asked", [False, True])
def test_a_resumed_run_equals_an_uninterrupted_one(plugin: OptimizerPlugin, chosen: dict[str, Any], asked: bool) -> None:
    whole = drive(create(plugin, chosen), 6)
    first = create(plugin, chosen)
    begun = drive(first, 3)
    if asked:
        first.ask()
    settings = plugin.settings(**({"population": 12} | chosen))
    second = plugin.restore(settings, GRID, json.loads(json.dumps(first.state(), allow_nan=False)))
    resumed = begun + drive(second, 3)
    assert all(np.array_equal(a, b) for a, b in zip(resumed, whole, strict=True))


@every
def test_an_engine_that_draws_otherwise_is_refused(plugin: OptimizerPlugin, chosen: dict[str, Any]) -> None:
    saved = create(plugin, chosen, seed=7)
    drive(saved, 3)
    other = plugin.settings(**({"population": 12, "seed": 8} | chosen))
    with pytest.raises(ReplayError) as refused:
        plugin.restore(other, GRID, saved.state())
    assert refused.value.iteration == 1
    assert refused.value.saved == refused.value.installed == saved.state()["library"]


class Drifting:
    """Each proposal shifts the start population by one more step. Proposal `since` and later ones add a shift of `drift`."""

    library = "drifting 2.0"

    def __init__(self, since: int, drift: int) -> None:
        self._since, self._drift = since, drift
        self._proposals = 0

    def propose(self) -> Indices:
        self._proposals += 1
        return START + self._proposals + (self._drift if self._proposals >= self._since else 0)

    def learn(self, population: Indices, objectives: Floats, tie_breakers: Floats) -> None:
        del population, objectives, tie_breakers


START = np.arange(12, dtype=np.int64).reshape(3, 4)


@pytest.mark.parametrize("since", [1, 2, 3])
@pytest.mark.parametrize("asked", [False, True])
def test_a_refused_replay_names_the_first_iteration_that_differs(since: int, asked: bool) -> None:
    saved = Replayed(START, Drifting(99, 0))
    drive(saved, 3)
    if asked:
        saved.ask()
    differs = since <= 2 or asked
    state = saved.state() | {"library": "drifting 1.0"}
    other = Replayed(np.zeros_like(START), Drifting(since, 1))
    if not differs:
        other.resume(state)
        return
    with pytest.raises(ReplayError) as refused:
        other.resume(state)
    assert (refused.value.iteration, refused.value.saved, refused.value.installed) == (since, "drifting 1.0", "drifting 2.0")


def test_a_damaged_start_population_is_refused() -> None:
    saved = Replayed(START, Drifting(99, 0))
    drive(saved, 2)
    state = saved.state() | {"first": (START + 1).tolist()}
    with pytest.raises(ReplayError) as refused:
        Replayed(START, Drifting(99, 0)).resume(state)
    assert refused.value.iteration == 0


def test_a_state_of_another_population_is_refused() -> None:
    state = create(OPTUNA, {}).state()
    with pytest.raises(InvalidInputError, match=r"\(12, 4\).*\(5, 4\)"):
        OPTUNA.restore(OPTUNA.settings(population=5), GRID, state)


def test_telling_twice_is_refused() -> None:
    optimizer = create(OPTUNA, {})
    answers = bowl(optimizer.ask().population)
    optimizer.tell(*answers)
    with pytest.raises(RuntimeError):
        optimizer.tell(*answers)


def test_one_whose_library_is_missing_says_which_extra_brings_it(monkeypatch: pytest.MonkeyPatch) -> None:
    module = "drivecal.optimizers.optuna_samplers"
    registry._load.cache_clear()
    monkeypatch.delitem(sys.modules, module)
    monkeypatch.setattr("drivecal.optimizers.replayed.find_spec", lambda wanted: None if wanted == "optuna" else object())
    with pytest.raises(InvalidInputError, match=r"\[optuna\]"):
        registry.optimizer("optuna")
    monkeypatch.undo()
    importlib.import_module(module)
    assert registry.optimizer("optuna").name == "optuna"

"""CMA-ES, whose answers are replayed: refused if it proposes otherwise. Promises of every optimizer: `test_optimizers.py`."""

import importlib
import sys

import numpy as np
import pytest

from drivecal.domain.errors import InvalidInputError, ReplayError
from drivecal.domain.parameters import Indices
from drivecal.optimizers.cma_es import CMA_ES
from drivecal.plugins import registry
from drivecal.plugins.ports import Floats, Optimizer

GRID = np.array([59, 201, 16, 2001])
SETTINGS = CMA_ES.settings(population=12)


def patchy(population: Indices) -> tuple[Floats, Floats]:
    rating = -((population / (GRID - 1) - 0.3) ** 2).sum(axis=1)
    missing = population[:, 0] % 5 == 0
    return np.where(missing, np.nan, np.round(4 * rating) / 4), np.where(missing, np.nan, rating)


def drive(optimizer: Optimizer, iterations: int) -> list[Indices]:
    result = []
    for _ in range(iterations):
        result.append(optimizer.ask().population)
        optimizer.tell(*patchy(result[-1]))
    return result


@pytest.mark.parametrize("since", [0, 1, 2, 3])
@pytest.mark.parametrize("asked", [False, True])
def test_a_refused_replay_names_the_first_iteration_that_differs(since: int, asked: bool) -> None:
    saved = CMA_ES.create(SETTINGS, GRID)
    drive(saved, 3)
    if asked:
        saved.ask()
    state = saved.state()
    digests = [digest if place < since else "other" for place, digest in enumerate(state["digests"])]
    changed = state | {"library": "cma 1.0", "digests": digests}
    if digests == state["digests"]:
        CMA_ES.restore(SETTINGS, GRID, changed)
        return
    with pytest.raises(ReplayError) as refused:
        CMA_ES.restore(SETTINGS, GRID, changed)
    assert (refused.value.iteration, refused.value.saved, refused.value.installed) == (since, "cma 1.0", state["library"])


def test_a_strategy_that_draws_otherwise_is_refused() -> None:
    saved = CMA_ES.create(SETTINGS, GRID)
    drive(saved, 3)
    with pytest.raises(ReplayError) as refused:
        CMA_ES.restore(CMA_ES.settings(population=12, seed=8), GRID, saved.state())
    assert refused.value.iteration == 1


def test_one_whose_library_is_missing_says_which_extra_brings_it(monkeypatch: pytest.MonkeyPatch) -> None:
    module = "drivecal.optimizers.cma_es"
    registry._load.cache_clear()
    monkeypatch.delitem(sys.modules, module)
    with monkeypatch.context() as patched:
        patched.setattr("importlib.util.find_spec", lambda _: None)
        with pytest.raises(InvalidInputError, match=r"\[cma\]"):
            registry.optimizer("cma_es")
    importlib.import_module(module)
    assert registry.optimizer("cma_es").name == "cma_es"

"""Every kind of optimizer survives one parameter, two values, one feasible set, equal, missing, tiny and huge objectives."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples
from tests.unit.optimizers.test_surrogate import task_of

from drivecal.analysis.aims import JudgedGoals
from drivecal.analysis.goals import Aggregate, CellValue, Goals, Objective
from drivecal.domain.parameters import Indices, Kind
from drivecal.optimizers.built_in import GENETIC, RANDOM, SWARM
from drivecal.optimizers.cma_es import CMA_ES
from drivecal.optimizers.repair import RepairingOptimizer, checked_proposal
from drivecal.optimizers.surrogate.plugin import SURROGATE, SurrogateSettings
from drivecal.plugins.ports import Floats, OptimizerPlugin
from drivecal.plugins.search import CellAnswer

POPULATIONS: dict[str, OptimizerPlugin] = {"genetic": GENETIC, "random": RANDOM, "swarm": SWARM, "cma_es": CMA_ES}
GRID: Kind = "grid"
searches = given(
    sizes=st.sampled_from([[101], [2], [2, 2], [3, 50]]),
    landscape=st.sampled_from(["bowl", "flat", "missing", "tiny", "huge", "offset"]),
    seed=st.integers(0, 100),
    one_is_feasible=st.booleans(),
)


def objective(population: Indices, n_values: Indices, landscape: str) -> Floats:
    """Returns the objectives of a population."""
    bowl = -(((population / (n_values - 1)) - 0.3) ** 2).sum(axis=1)
    values: dict[str, Floats] = {
        "bowl": bowl,
        "flat": np.zeros(len(population)),
        "missing": np.full(len(population), np.nan),
        "tiny": 1e-12 * bowl,
        "huge": 1e15 * bowl,
        "offset": 1e9 + bowl,
    }
    return values[landscape]


@pytest.mark.parametrize("kind", POPULATIONS)
@searches
@settings(max_examples=examples(12), deadline=None)
def test_every_optimizer_of_populations_searches_the_smallest_spaces(
    kind: str, sizes: list[int], landscape: str, seed: int, one_is_feasible: bool
) -> None:
    plugin, n_values = POPULATIONS[kind], np.array(sizes)
    options = plugin.settings.model_validate({"kind": plugin.name, "population": 6, "iterations": 8, "seed": seed})
    optimizer = plugin.create(options, n_values)
    if one_is_feasible:
        optimizer = RepairingOptimizer(optimizer, np.ones_like)
    before = None
    for _ in range(8):
        proposal = checked_proposal(kind, optimizer.ask(), 6, n_values, before)
        before = proposal.population
        values = objective(before, n_values, landscape)
        optimizer.tell(values, values)


@searches
@settings(max_examples=examples(8), deadline=None)
def test_the_surrogate_searches_the_smallest_spaces(sizes: list[int], landscape: str, seed: int, one_is_feasible: bool) -> None:
    n_values, value = np.array(sizes), CellValue(measure="m")
    goals = Goals((Objective("m", value, {"s": 1.0}, Aggregate(), 1),))

    task = task_of(JudgedGoals(goals, ("s",)), 12, 1, n_values, [GRID] * len(sizes))
    if one_is_feasible:
        one: dict[str, Any] = {
            "start": np.ones((1, len(sizes)), int),
            "sample": lambda count, _: np.ones((count, len(sizes)), int),
        }
        task = replace(task, feasible=lambda rows: np.all(rows == 1, axis=1), repair=np.ones_like, **one)
    search = SURROGATE.begin(SurrogateSettings(seed=seed), task)
    asked: set[tuple[int, ...]] = set()
    while cells := search.ask(2):
        asked |= {cell.indices for cell in cells}
        assert task.feasible(np.array([cell.indices for cell in cells])).all()
        values = objective(np.array([cell.indices for cell in cells]), n_values, landscape).tolist()
        search.tell([CellAnswer(cell, (each,), np.isnan(each)) for cell, each in zip(cells, values, strict=True)])
    assert len(asked) == min(12, 1 if one_is_feasible else int(n_values.prod()))

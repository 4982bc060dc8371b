"""Every kind of optimizer survives one parameter, two values, one feasible set, equal, missing, tiny and huge objectives."""

import json
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
from drivecal.optimizers.genetic import BitEncoding
from drivecal.optimizers.repair import RepairingOptimizer, checked_proposal
from drivecal.optimizers.surrogate.plugin import SURROGATE, SurrogateSettings
from drivecal.plugins.ports import Floats, Optimizer, OptimizerPlugin
from drivecal.plugins.search import CellAnswer

POPULATIONS: dict[str, OptimizerPlugin] = {"genetic": GENETIC, "random": RANDOM, "swarm": SWARM}
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
def test_populations_fill_tiny_spaces(kind: str, sizes: list[int], landscape: str, seed: int, one_is_feasible: bool) -> None:
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


N_VALUES = np.array([2 * 10**15 + 1, 10**9 + 1, 2, 7, 201])
KINDS: tuple[Kind, ...] = ("continuous", "continuous", "choice", "choice", "integer")
TARGET = np.array([0.31, 0.77, 1, 0.5, 0.2])
START = np.array([[2 * 10**15, 123_456_789, 1, 3, 17], [1_999_999_999_999_999, 0, 0, 6, 200]])

every = pytest.mark.parametrize("plugin", [GENETIC, RANDOM, SWARM], ids=lambda plugin: plugin.name)


def closeness(population: Indices) -> Floats:
    away: Floats = np.abs(population / (N_VALUES - 1) - TARGET)
    away[:, 2] = population[:, 2] != 1
    away[:, 3] = population[:, 3] != 3
    return np.asarray(-away.sum(axis=1), dtype=np.float64)


def drive(optimizer: Optimizer, iterations: int) -> list[Indices]:
    told = []
    for _ in range(iterations):
        told.append(optimizer.ask().population)
        optimizer.tell(closeness(told[-1]), closeness(told[-1]))
    return told


@every
def test_it_starts_with_given_sets_stays_in_the_space_and_resumes_exactly(plugin: OptimizerPlugin) -> None:
    settings = plugin.settings.model_validate({"kind": plugin.name, "population": 12, "seed": 3})
    whole = drive(plugin.create(settings, N_VALUES, START, KINDS), 6)
    assert whole[0][:2].tolist() == START.tolist()
    for population in whole:
        assert population.min() >= 0
        assert (population < N_VALUES).all()
    first = plugin.create(settings, N_VALUES, START, KINDS)
    drive(first, 3)
    state = json.loads(json.dumps(first.state(), allow_nan=False))
    rest = drive(plugin.restore(settings, N_VALUES, state, KINDS), 3)
    assert [population.tolist() for population in rest] == [population.tolist() for population in whole[3:]]


@every
def test_it_gets_closer_than_its_start(plugin: OptimizerPlugin) -> None:
    settings = plugin.settings.model_validate({"kind": plugin.name, "population": 20, "seed": 1})
    told = drive(plugin.create(settings, N_VALUES, None, KINDS), 40)
    assert max(closeness(population).max() for population in told[1:]) > closeness(told[0]).max()


@given(st.integers(2, 2 * 10**15 + 1), st.data())
def test_every_index_of_a_huge_grid_has_a_pattern_and_survives_it(n_values: int, data: st.DataObject) -> None:
    encoding = BitEncoding(np.array([n_values, 101]))
    index = data.draw(st.integers(0, n_values - 1))
    given_indices = np.array([[index, 55]])
    patterns = encoding.patterns(given_indices)
    assert encoding.indices(patterns).tolist() == given_indices.tolist()
    assert encoding.from_chromosomes(encoding.chromosomes(patterns)).tolist() == patterns.tolist()
    pattern = data.draw(st.integers(0, 2 ** int(encoding.bits[0]) - 1))
    (meant,) = encoding.indices(np.array([[pattern, 0]]))[:, 0].tolist()
    assert meant == (2 * pattern * (n_values - 1) + 2 ** int(encoding.bits[0]) - 1) // (2 * (2 ** int(encoding.bits[0]) - 1))

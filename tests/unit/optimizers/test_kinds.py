"""Every optimizer on continuous parameters, integers and choices."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.domain.parameters import Indices, Kind
from drivecal.optimizers.built_in import GENETIC, RANDOM, SWARM
from drivecal.optimizers.cma_es import CMA_ES
from drivecal.optimizers.genetic import BitEncoding
from drivecal.plugins.ports import Floats, Optimizer, OptimizerPlugin

N_VALUES = np.array([2 * 10**15 + 1, 10**9 + 1, 2, 7, 201])
KINDS: tuple[Kind, ...] = ("continuous", "continuous", "choice", "choice", "integer")
TARGET = np.array([0.31, 0.77, 1, 0.5, 0.2])
START = np.array([[2 * 10**15, 123_456_789, 1, 3, 17], [1_999_999_999_999_999, 0, 0, 6, 200]])

every = pytest.mark.parametrize("plugin", [GENETIC, RANDOM, SWARM, CMA_ES], ids=lambda plugin: plugin.name)


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

"""The particle swarm: Equations 4 and 5 to the letter, and its edges."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from tests.support.effort import examples

from drivecal.domain.errors import InvalidInputError
from drivecal.domain.parameters import Indices
from drivecal.optimizers.built_in import SWARM, SwarmSettings
from drivecal.plugins.ports import Floats

GRID = np.array([59, 201, 201, 2001, 1501, 101])


def bowl(population: Indices, n_values: Indices = GRID) -> Floats:
    """Largest (0) at a third of every range."""
    return -np.asarray(((population / (n_values - 1) - 1 / 3) ** 2).sum(axis=1), dtype=np.float64)


def positions(optimizer: Any) -> Floats:
    return np.array(optimizer.state()["individuals"])


def test_a_step_is_equations_4_and_5() -> None:
    optimizer = SWARM.create(SwarmSettings(population=12, c1=0.3, c2=0.7, inertia=0.6, seed=5), GRID)
    for _ in range(4):
        population = optimizer.ask().population
        optimizer.tell(bowl(population), np.zeros(12))
    before = optimizer.state()
    x, v, own = (np.array(before[name]) for name in ("individuals", "velocities", "best_individuals"))
    leader = own[np.argmax(before["best_fitness"][0])]
    generator = np.random.Generator(np.random.PCG64())
    generator.bit_generator.state = before["generator"]
    r, s = generator.random(x.shape), generator.random(x.shape)
    v = 0.6 * v + 0.3 * r * (own - x) + 0.7 * s * (leader - x)
    expected = np.clip(x + v, 0, 1)
    proposal = optimizer.ask()
    assert np.array_equal(positions(optimizer), expected)
    assert np.array_equal(proposal.population, np.rint(expected * (GRID - 1)))


@given(seed=st.integers(0, 10_000), inertia=st.floats(0, 1), c=st.floats(0, 1))
@settings(max_examples=examples(40))
def test_particles_stay_in_the_space_and_stop_at_its_edge(seed: int, inertia: float, c: float) -> None:
    optimizer = SWARM.create(SwarmSettings(population=8, c1=c, c2=c, inertia=inertia, seed=seed), GRID)
    for _ in range(12):
        population = optimizer.ask().population
        assert population.min() >= 0
        assert np.all(population < GRID)
        state = optimizer.state()
        x, v = np.array(state["individuals"]), np.array(state["velocities"])
        assert np.all((x >= 0) & (x <= 1))
        optimizer.tell(bowl(population), np.zeros(8))
        assert np.all(v[(x == 0) & (population > 0)] == 0)


def test_a_particle_that_stays_on_its_grid_point_is_not_requested_again() -> None:
    optimizer = SWARM.create(SwarmSettings(population=30, inertia=0.3), np.array([3, 3]))
    last: npt.NDArray[np.int64] | None = None
    kept = 0
    for _ in range(12):
        proposal = optimizer.ask()
        if last is not None:
            assert np.array_equal(proposal.changed, (proposal.population != last).any(axis=1))
            kept += int((~proposal.changed).sum())
        last = proposal.population
        optimizer.tell(bowl(last, np.array([3, 3])), np.zeros(30))
    assert kept > 0


def test_each_particle_remembers_its_own_best_and_equal_ones_go_by_the_rating() -> None:
    start = np.array([[10, 100], [40, 50], [20, 20]])
    optimizer = SWARM.create(SwarmSettings(population=3), np.array([59, 201]), start)
    optimizer.ask()
    optimizer.tell(np.array([3.0, np.nan, 3.0]), np.array([0.1, 0.9, 0.2]))
    optimizer.ask()
    optimizer.tell(np.array([3.0, 2.0, 2.9]), np.array([0.05, 0.0, 9.0]))
    best = np.array(optimizer.state()["best_individuals"]) * (58, 200)
    assert best[0].tolist() == pytest.approx([10, 100])  # equal objective, lower rating
    assert best[2].tolist() == pytest.approx([20, 20])
    assert np.array_equal(best[1], positions(optimizer)[1] * (58, 200))  # its first result


@pytest.mark.parametrize("field", ["c1", "c2", "inertia"])
@pytest.mark.parametrize("value", [-0.1, 1.1, float("nan"), "0.5", True])
def test_factors_outside_0_to_1_are_refused_by_name(field: str, value: object) -> None:
    with pytest.raises(ValidationError) as refused:
        SWARM.settings.model_validate({"kind": "swarm", field: value})
    assert refused.value.errors()[0]["loc"] == (field,)


@pytest.mark.parametrize("n_values", [np.array([5, 1]), np.array([], dtype=np.int64)])
def test_a_space_without_anything_to_search_is_refused(n_values: Indices) -> None:
    with pytest.raises(InvalidInputError):
        SWARM.create(SwarmSettings(population=4), n_values)

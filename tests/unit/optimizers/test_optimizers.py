"""Promises of every optimizer, of optimizers that replace sets, and of the genetic algorithm."""

import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError
from scipy import stats
from tests.support.effort import examples

from drivecal.domain.errors import InvalidInputError
from drivecal.domain.parameters import Indices
from drivecal.optimizers.built_in import GENETIC, RANDOM, SWARM, GeneticSettings, RandomSettings
from drivecal.optimizers.population import ranking
from drivecal.optimizers.repair import checked_proposal
from drivecal.plugins.ports import Floats, Optimizer, OptimizerPlugin, Proposal

SMALL = np.array([5, 16, 3, 40])

Told = list[tuple[Indices, npt.NDArray[np.bool_]]]
every = pytest.mark.parametrize("plugin", [GENETIC, RANDOM, SWARM], ids=lambda plugin: plugin.name)
unreplayed = pytest.mark.parametrize("plugin", [GENETIC, RANDOM, SWARM], ids=lambda plugin: plugin.name)
replacing = pytest.mark.parametrize("plugin", [GENETIC, RANDOM], ids=lambda plugin: plugin.name)


def chosen(plugin: OptimizerPlugin, **values: Any) -> BaseModel:
    return plugin.settings.model_validate({"kind": plugin.name, **values})


def coarse(population: Indices) -> tuple[Floats, Floats]:
    """A score with many ties and a rating that breaks some, both pure functions of the individual."""
    rating = np.cos(population * np.arange(1, population.shape[1] + 1)).sum(axis=1)
    return np.round(rating), np.round(rating, 1)


def patchy(population: Indices) -> tuple[Floats, Floats]:
    """Some individuals have no result."""
    objectives, ratings = coarse(population)
    missing = population[:, 0] == 1
    return np.where(missing, np.nan, objectives), np.where(missing, np.nan, ratings)


def drive(optimizer: Optimizer, iterations: int, evaluate: Callable[[Indices], tuple[Floats, Floats]] = coarse) -> Told:
    result: Told = []
    for _ in range(iterations):
        proposal = optimizer.ask()
        result.append((proposal.population, proposal.changed))
        optimizer.tell(*evaluate(proposal.population))
    return result


def through_json(state: Mapping[str, Any]) -> Any:
    return json.loads(json.dumps(state, allow_nan=False))


def assert_same(one: Told, other: Told) -> None:
    assert len(one) == len(other)
    for (population, changed), (other_population, other_changed) in zip(one, other, strict=True):
        assert np.array_equal(population, other_population)
        assert np.array_equal(changed, other_changed)


@unreplayed
@given(seed=st.integers(0, 2**63 - 1), stop=st.integers(0, 6), asked=st.booleans(), population=st.integers(2, 30))
@settings(max_examples=examples(60))
def test_a_resumed_run_equals_a_whole_one(plugin: OptimizerPlugin, seed: int, stop: int, asked: bool, population: int) -> None:
    options = chosen(plugin, population=population, seed=seed)
    whole = drive(plugin.create(options, SMALL), 9, patchy)
    first = plugin.create(options, SMALL)
    begun = drive(first, stop, patchy)
    if asked:
        first.ask()
    second = plugin.restore(options, SMALL, through_json(first.state()))
    assert_same(begun + drive(second, 9 - stop, patchy), whole)


@every
def test_a_run_restored_between_ask_and_tell_takes_the_answers_without_asking_again(plugin: OptimizerPlugin) -> None:
    options = chosen(plugin, population=20)
    whole = drive(plugin.create(options, SMALL), 6)
    first = plugin.create(options, SMALL)
    drive(first, 2)
    asked = first.ask()
    second = plugin.restore(options, SMALL, through_json(first.state()))
    second.tell(*coarse(asked.population))
    assert_same(drive(second, 3), whole[3:])


@every
def test_what_a_caller_does_to_a_proposal_does_not_reach_the_optimizer(plugin: OptimizerPlugin) -> None:
    optimizer = plugin.create(chosen(plugin, population=20), SMALL)
    drive(optimizer, 3)
    proposal = optimizer.ask()
    kept = proposal.population.copy(), proposal.changed.copy()
    proposal.population[:] = 0
    proposal.changed[:] = True
    again = optimizer.ask()
    assert_same([kept], [(again.population, again.changed)])


@replacing
@given(seed=st.integers(0, 1000), population=st.integers(2, 50))
@settings(max_examples=examples(50))
def test_all_but_the_least_fit_stay_exactly_as_they_were(plugin: OptimizerPlugin, seed: int, population: int) -> None:
    optimizer = plugin.create(chosen(plugin, population=population, seed=seed), SMALL)
    before = optimizer.ask()
    assert before.changed.all()
    for _ in range(5):
        objectives, ratings = coarse(before.population)
        optimizer.tell(objectives, ratings)
        after = optimizer.ask()
        assert np.array_equal(after.population[~after.changed], before.population[~after.changed])
        least_fit = ranking(objectives, ratings)[population - int(after.changed.sum()) :]
        assert np.array_equal(np.flatnonzero(after.changed), np.sort(least_fit))
        before = after


@replacing
@pytest.mark.parametrize("population", [2, 37, 350, 1000])
def test_the_announced_number_of_requested_individuals_is_the_true_one(plugin: OptimizerPlugin, population: int) -> None:
    options = chosen(plugin, population=population, iterations=7)
    requested = sum(int(changed.sum()) for _, changed in drive(plugin.create(options, SMALL), 7))
    assert requested == plugin.requested_individuals(options)


@every
def test_telling_twice_is_refused(plugin: OptimizerPlugin) -> None:
    optimizer = plugin.create(chosen(plugin, population=4), SMALL)
    answers = coarse(optimizer.ask().population)
    optimizer.tell(*answers)
    with pytest.raises(RuntimeError):
        optimizer.tell(*answers)


@every
@pytest.mark.parametrize("wrong", [np.zeros(3), np.zeros((4, 1)), np.array([0, 0, 0, np.inf])], ids=["short", "matrix", "inf"])
def test_answers_that_do_not_fit_are_refused(plugin: OptimizerPlugin, wrong: Floats) -> None:
    optimizer = plugin.create(chosen(plugin, population=4), SMALL)
    optimizer.ask()
    with pytest.raises(ValueError, match=r"^objectives"):
        optimizer.tell(wrong, np.zeros(4))
    with pytest.raises(ValueError, match=r"^tie_breakers"):
        optimizer.tell(np.zeros(4), wrong)


@every
def test_a_state_of_another_population_is_refused(plugin: OptimizerPlugin) -> None:
    state = plugin.create(chosen(plugin, population=4), SMALL).state()
    with pytest.raises(InvalidInputError, match=r"\(4, 4\).*\(5, 4\)"):
        plugin.restore(chosen(plugin, population=5), SMALL, state)


def test_settings_of_another_optimizer_are_refused() -> None:
    with pytest.raises(TypeError, match=r"GeneticSettings.*RandomSettings"):
        GENETIC.create(RandomSettings(), SMALL)
    with pytest.raises(TypeError, match=r"RandomSettings.*GeneticSettings"):
        RANDOM.restore(GeneticSettings(), SMALL, {})


@every
@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("population", 1), ("population", 1e30), ("population", 10**30), ("population", True), ("population", "20"),
        ("iterations", 0), ("seed", -1), ("seed", 2**63), ("start", "sobol"), ("kind", "ants"), ("colour", "red"),
    ],
)  # fmt: skip
def test_settings_out_of_bounds_are_refused_by_name(plugin: OptimizerPlugin, field: str, value: object) -> None:
    with pytest.raises(ValidationError) as refused:
        chosen(plugin, **{field: value})
    assert [error["loc"] for error in refused.value.errors()] == [(field,)]


@pytest.mark.parametrize("value", [0, 1.1, -0.5, float("nan"), True, "0.5"])
def test_shares_are_shares(value: object) -> None:
    for plugin, field in ((GENETIC, "selection"), (GENETIC, "recombination"), (RANDOM, "renewal")):
        with pytest.raises(ValidationError, match=field):
            chosen(plugin, **{field: value})


def test_no_individual_is_a_parent_twice_in_one_generation() -> None:
    """Forty individuals, each marked by a bit of its own, all of them parents: no mark may turn up in two children."""
    start = np.eye(40, dtype=np.int64)
    options = chosen(GENETIC, population=40, selection=1.0, recombination=1.0, mutation=0.0)
    optimizer = GENETIC.create(options, np.full(40, 2), start)
    optimizer.ask()
    optimizer.tell(np.zeros(40), np.zeros(40))
    proposal = optimizer.ask()
    marks = proposal.population[proposal.changed].sum(axis=0)
    assert proposal.changed.sum() == 20
    assert marks.max() == 1


def test_random_search_draws_every_value_of_the_grid_equally_often() -> None:
    options = chosen(RANDOM, population=20_000, renewal=1.0)
    told = drive(RANDOM.create(options, SMALL), 2)
    population, changed = told[1]
    assert changed.all()
    for column, n in zip(population.T, SMALL.tolist(), strict=True):
        assert stats.chisquare(np.bincount(column, minlength=n)).pvalue > 1e-4


WHOLE, SOME = np.ones(3, dtype=np.bool_), np.array([True, False, True])
GOOD = np.array([[0, 1], [2, 3], [4, 0]])


@pytest.mark.parametrize(
    ("population", "changed", "before"),
    [
        (GOOD[:2], WHOLE[:2], None),
        (GOOD[:, :1], WHOLE, None),
        (GOOD.astype(np.float64), WHOLE, None),
        (GOOD, WHOLE.astype(np.int64), None),
        (GOOD + 1, WHOLE, None),
        (GOOD - 1, WHOLE, None),
        (GOOD, SOME, None),
        (GOOD, SOME, np.array([[0, 1], [2, 2], [4, 0]])),
    ],
)
def test_an_impossible_proposal_is_refused_by_its_plug_in(population: Any, changed: Any, before: Any) -> None:
    with pytest.raises(InvalidInputError, check=lambda error: "mine" in error.problems[0].field):
        checked_proposal("mine", Proposal(population, changed), 3, np.array([5, 4]), before)


def test_a_proposal_may_keep_individuals() -> None:
    proposal = Proposal(GOOD, SOME)
    assert checked_proposal("mine", proposal, 3, np.array([5, 4]), GOOD) is proposal

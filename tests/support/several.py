"""A plug-in's optimizer of several objectives, for tests: populations around the sets that no other feasible one dominates."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Literal, get_args

import numpy as np
import pytest
from tests.support.changes import install

from drivecal.analysis.front import non_dominated
from drivecal.contracts.specification import OptimizerSpecification
from drivecal.domain.parameters import Indices, Kind
from drivecal.optimizers.built_in import RANDOM
from drivecal.plugins.ports import Ability, Floats, Optimizer, OptimizerPlugin, Proposal


class SeveralSettings(OptimizerSpecification):
    """Settings."""

    kind: Literal["several"] = "several"


class SeveralSearch:
    """Proposes sets a step away from the best ones; its state is the last population and its answers."""

    def __init__(self, seed: int, n_values: Indices, state: Mapping[str, Any]) -> None:
        self._seed, self._n_values, self._state = seed, n_values, dict(state)

    def ask(self) -> Proposal:
        if (best := self._state.pop("best", None)) is not None:
            self._state["round"] += 1
            generator = np.random.default_rng([self._seed, self._state["round"]])
            parents = generator.choice(best, len(self._state["population"]))
            steps = np.rint(generator.normal(0, 0.1, parents.shape) * self._n_values)
            self._state["population"] = np.clip(parents + steps.astype(np.int64), 0, self._n_values - 1).tolist()
        population = np.array(self._state["population"], dtype=np.int64)
        return Proposal(population, np.ones(len(population), dtype=np.bool_))

    def tell(self, objectives: Floats, violations: Floats) -> None:
        population, known = np.array(self._state["population"]), ~np.isnan(violations)
        self._state["best"] = population[known][non_dominated(objectives[known], violations[known])].tolist()

    def state(self) -> dict[str, Any]:
        return dict(self._state)


class SeveralPlugin:
    """`optimizer: {kind: several}`."""

    name = "several"
    settings = SeveralSettings
    supports: frozenset[Ability] = frozenset(get_args(Ability))

    def requested_individuals(self, settings: Any) -> int:
        return int(settings.population * settings.iterations)

    def create(
        self, settings: Any, n_values: Indices, start: Indices | None = None, kinds: Sequence[Kind] | None = None
    ) -> Optimizer:
        first = RANDOM.create(RANDOM.settings(population=settings.population, seed=settings.seed), n_values, start, kinds)
        state = {"population": first.ask().population.tolist(), "round": 0}
        return SeveralSearch(settings.seed, n_values, state)

    def restore(
        self, settings: Any, n_values: Indices, state: Mapping[str, Any], kinds: Sequence[Kind] | None = None
    ) -> Optimizer:
        del kinds
        return SeveralSearch(settings.seed, n_values, state)


SEARCH: dict[str, Any] = {"kind": "several", "population": 24, "iterations": 8, "seed": 3}
SEVERAL: OptimizerPlugin = SeveralPlugin()


@contextmanager
def installed() -> Iterator[None]:
    """Lets campaigns choose it."""
    with pytest.MonkeyPatch.context() as patched:
        install(patched, "optimizer", SEVERAL)
        yield

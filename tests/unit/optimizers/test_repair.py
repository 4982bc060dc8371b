"""Counts of what repair makes of proposals, and optimizers that begin within constraints."""

from decimal import Decimal
from typing import Any

import numpy as np
import pytest

from drivecal.bundles.expressions import Constraint
from drivecal.campaigns.resolve.optimizer import Optimization
from drivecal.contracts.campaign import Repaired
from drivecal.domain.constraints import Constraints
from drivecal.domain.parameters import Indices, Parameter, ParameterSpace
from drivecal.optimizers.built_in import GENETIC, RANDOM, SWARM
from drivecal.optimizers.repair import RepairingOptimizer
from drivecal.plugins.ports import Floats, OptimizerPlugin, Proposal

CURVE = [f"k{number}" for number in range(8)]
MONOTONE = " >= ".join(CURVE)
SPACE = ParameterSpace(tuple(Parameter.from_step(name, Decimal(0), Decimal(2), Decimal("0.02")) for name in CURVE))
CONSTRAINTS = Constraints(SPACE, {MONOTONE: Constraint(MONOTONE, dict.fromkeys(CURVE, ()))})


class Proposing:
    """Proposes one population."""

    def __init__(self, population: Indices) -> None:
        self._proposal = Proposal(population, np.ones(len(population), dtype=np.bool_))

    def ask(self) -> Proposal:
        return self._proposal

    def tell(self, objectives: Floats, tie_breakers: Floats) -> None: ...

    def state(self) -> dict[str, Any]:
        return {}


def test_replaced_proposals_and_new_sets_are_counted() -> None:
    proposed = np.array([[1, 1], [2, 2], [3, 3], [3, 3], [4, 4], [5, 5]])
    repaired = np.array([[1, 1], [1, 1], [7, 7], [7, 7], [8, 8], [9, 9]])
    optimizer = RepairingOptimizer(Proposing(proposed), lambda _: repaired)
    optimizer.known.add((8, 8))
    assert optimizer.ask().population.tolist() == repaired.tolist()
    first = optimizer.repaired
    assert first == Repaired(proposed=4, distinct=2)
    assert first + first == Repaired(proposed=8, distinct=4)
    assert optimizer.again == [1, 3, 4]


@pytest.mark.parametrize(("proposed", "distinct", "collapses"), [(0, 0, False), (10, 1, False), (11, 1, True), (5, 0, True)])
def test_fewer_than_a_tenth_of_new_sets_is_a_collapse(proposed: int, distinct: int, *, collapses: bool) -> None:
    assert Repaired(proposed=proposed, distinct=distinct).collapses is collapses


@pytest.mark.parametrize("plugin", [GENETIC, RANDOM, SWARM], ids=lambda plugin: plugin.name)
def test_a_start_population_within_constraints_is_drawn_there(plugin: OptimizerPlugin) -> None:
    given = np.array([[90, 80, 70, 60, 50, 40, 30, 20]])
    optimization = Optimization(plugin, plugin.settings(population=200), None, 5)
    population = optimization.begin(CONSTRAINTS, given).ask().population
    assert CONSTRAINTS.feasible(population).all()
    assert population[:1].tolist() == given.tolist()
    assert len(np.unique(population, axis=0)) >= 198
    assert population.tolist() == optimization.begin(CONSTRAINTS, given).ask().population.tolist()

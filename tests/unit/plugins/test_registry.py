"""Finding plug-ins by their entry points."""

from collections.abc import Callable

import pytest

from drivecal.domain.errors import InvalidInputError
from drivecal.plugins import registry

BUILT_IN = {
    "drivecal.driving_functions": ["frenet"],
    "drivecal.vehicles": ["single_track"],
    "drivecal.evaluators": ["reference"],
    "drivecal.optimizers": ["genetic", "random"],
    "drivecal.scenarios": ["highway"],
    "drivecal.simulators": ["highway"],
}


@pytest.mark.parametrize("group", BUILT_IN)
def test_the_built_in_plugins_are_registered_as_a_users_own_would_be(group: str) -> None:
    assert set(BUILT_IN[group]) <= set(registry.names(group))


def test_an_unknown_group_is_empty() -> None:
    assert registry.names("drivecal.nonsense") == []


@pytest.mark.parametrize(
    ("find", "field", "installed"),
    [
        (registry.driving_function, "driving_function", "frenet"),
        (registry.vehicle, "vehicle.model", "single_track"),
        (registry.evaluator, "evaluator", "reference"),
        (registry.optimizer, "optimizer.kind", "genetic"),
        (registry.catalogue, "catalogue", "highway"),
        (registry.simulator, "simulator", "highway"),
    ],
)
def test_an_unknown_name_is_refused_with_the_installed_ones(find: Callable[[str], object], field: str, installed: str) -> None:
    with pytest.raises(InvalidInputError, match="'nonsense'") as refused:
        find("nonsense")
    (problem,) = refused.value.problems
    assert problem.field == field
    assert installed in problem.remedy

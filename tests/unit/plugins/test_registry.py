"""Finding plug-ins by their entry points."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from drivecal.domain.errors import InvalidInputError
from drivecal.domain.parameters import Indices
from drivecal.optimizers.built_in import GENETIC
from drivecal.plugins import registry
from drivecal.plugins.ports import Optimizer, OptimizerPlugin

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


def test_a_plugin_of_another_package_is_found(tmp_path: Path) -> None:
    """A package as a user would install it: a module and its entry point, nothing of ours changed."""
    (tmp_path / "their_catalogue.py").write_text("class Theirs:\n    name = 'theirs'\n    scenarios = {}\nPLUGIN = Theirs()\n")
    metadata = tmp_path / "theirs-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[drivecal.scenarios]\ntheirs = their_catalogue:PLUGIN\n")
    program = (
        "from drivecal.plugins import registry; print(registry.catalogue('theirs').name, registry.names('drivecal.scenarios'))"
    )
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    process = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, env=environment)
    assert process.stdout.strip() == "theirs ['highway', 'theirs']"


def test_an_optimizer_that_declares_nothing_gets_grids_and_is_not_told_kinds(monkeypatch: pytest.MonkeyPatch) -> None:
    class Plain:
        name, settings = "plain", GENETIC.settings

        def create(self, settings: Any, n_values: Indices, start: Indices | None = None) -> Optimizer:
            return GENETIC.create(settings, n_values, start)

        def restore(self, settings: Any, n_values: Indices, state: Any) -> Optimizer:
            return GENETIC.restore(settings, n_values, state)

    entry = SimpleNamespace(name="plain", value="theirs:PLAIN", load=Plain)
    monkeypatch.setattr(registry, "_installed", lambda _: {"plain": (entry,)})
    registry._load.cache_clear()
    plugin = cast("OptimizerPlugin", registry.optimizer("plain"))
    registry._load.cache_clear()
    assert plugin.supports == {"grid", "integer"}
    settings, n_values = plugin.settings.model_validate({"kind": "genetic", "population": 4}), np.array([5, 5])
    optimizer = plugin.create(settings, n_values, None, ["grid", "integer"])
    restored = plugin.restore(settings, n_values, optimizer.state(), ["grid", "integer"])
    assert restored.ask().population.tolist() == optimizer.ask().population.tolist()

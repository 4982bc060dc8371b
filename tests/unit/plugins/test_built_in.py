"""Plug-ins are found by their entry points. Every built-in one satisfies its port and describes itself without simulator and compiler."""

import inspect
import json
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from typing import Any

import pytest

from drivecal.domain.errors import InvalidInputError
from drivecal.optimizers.built_in import External
from drivecal.plugins import ports, registry, simulators
from drivecal.plugins.search import SearchPlugin

PORTS: dict[str, type] = {
    "drivecal.driving_functions": ports.DrivingFunction,
    "drivecal.vehicles": ports.Vehicle,
    "drivecal.evaluators": ports.Evaluator,
    "drivecal.optimizers": ports.OptimizerPlugin,
    "drivecal.scenarios": ports.Catalogue,
    "drivecal.simulators": simulators.InstalledSimulator,
}


def members(port: type) -> set[str]:
    """Returns what a port asks for, inherited or not: annotated attributes, properties and methods."""
    names = {name for base in port.__mro__ for name in {*vars(base), *inspect.get_annotations(base)}}
    return {name for name in names if not name.startswith("_")}


BUILT_IN = [
    pytest.param(group, entry, id=f"{group.removeprefix('drivecal.')}-{entry.name}")
    for group in PORTS
    for entry in entry_points(group=group)
    if entry.value.startswith("drivecal.")
]


def signature(function: Any) -> list[tuple[str, Any]]:
    """Parameter names and kinds, without self and annotations."""
    parameters = inspect.signature(function).parameters.values()
    return [(parameter.name, parameter.kind) for parameter in parameters if parameter.name != "self"]


@pytest.mark.parametrize(("group", "entry"), BUILT_IN)
def test_it_has_what_its_port_asks_for(group: str, entry: EntryPoint) -> None:
    plugin = entry.load()
    port = SearchPlugin if isinstance(plugin, SearchPlugin) else ports.Named if isinstance(plugin, External) else PORTS[group]
    assert members(port) >= {"name"}
    for member in members(port):
        assert hasattr(plugin, member), f"{entry.value} has no {member}"
    for name, method in inspect.getmembers(port, inspect.isfunction):
        if not name.startswith("_"):
            assert signature(getattr(plugin, name)) == signature(method), f"{entry.value}.{name}"


@pytest.mark.parametrize("entry", [case.values[1] for case in BUILT_IN], ids=[case.id for case in BUILT_IN])
def test_it_is_registered_under_its_own_name(entry: EntryPoint) -> None:
    assert entry.load().name == entry.name


@pytest.mark.parametrize(("group", "entry"), [case for case in BUILT_IN if "version" in members(PORTS[str(case.values[0])])])
def test_it_has_a_version_where_stored_results_depend_on_it(group: str, entry: EntryPoint) -> None:
    version = entry.load().version
    assert isinstance(version, str), group
    assert version.strip()


def test_loading_them_imports_neither_simulator_nor_compiler() -> None:
    # whose roads are measured from their networks, at last
    groups = sorted(PORTS, key=lambda group: group == "drivecal.scenarios")
    program = (
        f"import json, sys; from importlib.metadata import entry_points\n"
        f"for group in {groups!r}:\n"
        f"    scipy = 'scipy' in sys.modules\n"
        f"    for entry in entry_points(group=group):\n"
        f"        plugin = entry.load() if entry.value.startswith('drivecal.') else None\n"
        f"        for name in ('spaces', 'scenarios', 'parameters', 'settings'): getattr(plugin, name, None)\n"
        f"print(json.dumps([scipy, sorted(sys.modules)]))"
    )
    process = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    needs_scipy, imported = json.loads(process.stdout)
    assert not needs_scipy, "before the scenarios"
    assert not set(imported) & {"libsumo", "numba", "ray", "sqlalchemy", "fastapi"}


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

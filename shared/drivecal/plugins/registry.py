"""Discovery of plug-ins by Python entry points, for built-in plug-ins and other installed packages alike.

A plug-in that cannot be used (its import fails, two packages claim its name) is reported by `broken`, refused when it is named, and missing
from the lists; nothing else fails with it.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, cast

from drivecal.contracts.inventory import BrokenPluginAnswer
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.plugins.ports import Catalogue, DrivingFunction, Evaluator, OptimizerPlugin, Vehicle
from drivecal.plugins.search import SearchPlugin
from drivecal.plugins.simulators import InstalledSimulator

CATALOGUES = "drivecal.scenarios"
DRIVING_FUNCTIONS = "drivecal.driving_functions"
VEHICLES = "drivecal.vehicles"
EVALUATORS = "drivecal.evaluators"
OPTIMIZERS = "drivecal.optimizers"
SIMULATORS = "drivecal.simulators"
PROBLEMS = "drivecal.problems"

KINDS: Mapping[str, str] = {
    CATALOGUES: "scenario catalogue",
    DRIVING_FUNCTIONS: "driving function",
    VEHICLES: "vehicle model",
    EVALUATORS: "evaluator",
    OPTIMIZERS: "optimizer",
    SIMULATORS: "simulator",
    PROBLEMS: "problem",
}
"""Words for a plug-in, by entry point group."""

_READ: Mapping[str, Callable[[Any], object]] = {
    CATALOGUES: lambda plugin: [(plugin.name, scenario.id) for scenario in plugin.scenarios.values()],
    DRIVING_FUNCTIONS: lambda plugin: (plugin.name, dict(plugin.spaces)),
    VEHICLES: lambda plugin: (plugin.name, list(plugin.parameters)),
    EVALUATORS: lambda plugin: plugin.name,
    OPTIMIZERS: lambda plugin: (plugin.name, plugin.settings.model_fields, plugin.supports),
    SIMULATORS: lambda plugin: plugin.name,
    PROBLEMS: lambda folder: (folder / "problem.yaml").read_bytes(),
}
"""Reads what lists and campaigns need of a plug-in."""
_LONGEST = 300
"""Characters of an exception's message in an error."""


class BrokenPlugin(BrokenPluginAnswer):
    """An installed plug-in that cannot be used. `package`: the distributions that register it."""

    @property
    def kind(self) -> str:
        """The word for it."""
        return KINDS.get(self.group, "plug-in")

    def __str__(self) -> str:
        return f"the {self.kind} {self.name!r} of {self.package} cannot be used: {self.error}"


@cache
def _installed(group: str) -> dict[str, tuple[EntryPoint, ...]]:
    """Returns the entry points by name. Several of one name differ in the object that they name."""
    by_name: dict[str, dict[str, EntryPoint]] = {}
    for entry in sorted(entry_points(group=group), key=lambda entry: (entry.name, entry.value)):
        by_name.setdefault(entry.name, {}).setdefault(entry.value, entry)
    return {name: tuple(entries.values()) for name, entries in by_name.items()}


def names(group: str) -> list[str]:
    """Returns the names registered in an entry point group, sorted, including broken plug-ins."""
    return list(_installed(group))


def broken() -> list[BrokenPlugin]:
    """Returns the installed plug-ins that cannot be used. Imports all of them, once."""
    loaded = [plugin for group in KINDS for plugin in _listed(group)]
    return [plugin for plugin in loaded if isinstance(plugin, BrokenPlugin)]


@cache
def _load(group: str, name: str) -> Any:
    """Returns a plug-in, or a BrokenPlugin. It stays broken until the process ends: an import half done cannot be done again.

    Raises InvalidInputError as the plug-in does, if it lacks an optional package.
    """
    entries = _installed(group)[name]
    if len(entries) > 1:
        listed = " and ".join(f"{_package(entry)} ({entry.value})" for entry in entries)
        packages = ", ".join(dict.fromkeys(map(_package, entries)))
        return BrokenPlugin(group=group, name=name, package=packages, error=f"the name is registered by {listed}")
    (entry,) = entries
    try:
        plugin = entry.load()
        if group in _READ:
            _READ[group](plugin)
    except InvalidInputError:
        raise
    except (Exception, SystemExit) as error:  # noqa: BLE001  # a foreign module may raise anything when it is imported
        text = " ".join(str(error).split())[:_LONGEST]
        said = f"{type(error).__name__}: {text}" if text else type(error).__name__
        return BrokenPlugin(group=group, name=name, package=_package(entry), error=said)
    return plugin


def _package(entry: EntryPoint) -> str:
    return "an unknown package" if entry.dist is None else entry.dist.name


def _find(group: str, name: str, field: str) -> Any:
    kind = KINDS[group]
    if name not in _installed(group):
        remedy = f"installed: {', '.join(names(group)) or 'none'}"
        raise InvalidInputError(Problem(field, f"there is no {kind} {name!r}", remedy))
    plugin = _load(group, name)
    if isinstance(plugin, BrokenPlugin):
        remedy = f"mend or uninstall {plugin.package}, and start drivecal again"
        raise InvalidInputError(Problem(field, str(plugin), remedy))
    return plugin


def _listed(group: str) -> Iterator[Any]:
    """Yields the plug-ins of a group, broken ones included, except if an optional package is missing."""
    for name in names(group):
        with suppress(InvalidInputError):
            yield _load(group, name)


def _usable(group: str) -> list[Any]:
    return [plugin for plugin in _listed(group) if not isinstance(plugin, BrokenPlugin)]


def driving_function(name: str) -> DrivingFunction:
    """Returns a driving function by name. Raises InvalidInputError listing the installed names."""
    return cast("DrivingFunction", _find(DRIVING_FUNCTIONS, name, "driving_function"))


def driving_functions() -> list[DrivingFunction]:
    """Returns all installed driving functions that can be used."""
    return _usable(DRIVING_FUNCTIONS)


def vehicle(name: str) -> Vehicle:
    """Returns a vehicle model by name. Raises InvalidInputError listing the installed names."""
    return cast("Vehicle", _find(VEHICLES, name, "vehicle.model"))


def evaluator(name: str) -> Evaluator:
    """Returns a comfort evaluator by name. Raises InvalidInputError listing the installed names."""
    return cast("Evaluator", _find(EVALUATORS, name, "evaluator"))


def optimizer(name: str) -> OptimizerPlugin | SearchPlugin:
    """Returns an optimizer by name. Raises InvalidInputError listing the installed names."""
    return cast("OptimizerPlugin | SearchPlugin", _find(OPTIMIZERS, name, "optimizer.kind"))


def optimizers() -> list[OptimizerPlugin | SearchPlugin]:
    """Returns all installed optimizers that can be used."""
    return _usable(OPTIMIZERS)


def simulator(name: str) -> InstalledSimulator:
    """Returns a simulator of scenarios with a task by name. Raises InvalidInputError listing the installed names."""
    return cast("InstalledSimulator", _find(SIMULATORS, name, "simulator"))


def catalogue(name: str) -> Catalogue:
    """Returns a scenario catalogue by name. Raises InvalidInputError listing the installed names."""
    return cast("Catalogue", _find(CATALOGUES, name, "catalogue"))


def catalogues() -> list[Catalogue]:
    """Returns all installed scenario catalogues that can be used."""
    return _usable(CATALOGUES)


def problems() -> dict[str, Path]:
    """Returns the folders of all installed problems by name; `drivecal.bundles.installed` reads them."""
    return {name: folder for name in names(PROBLEMS) if isinstance(folder := _load(PROBLEMS, name), Path)}

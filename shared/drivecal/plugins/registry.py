"""Discovery of plug-ins by Python entry points, for built-in plug-ins and other installed packages alike."""

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, cast

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.plugins.ports import Catalogue, DrivingFunction, Evaluator, OptimizerPlugin, Vehicle


@cache
def _installed(group: str) -> dict[str, EntryPoint]:
    return {entry.name: entry for entry in sorted(entry_points(group=group), key=lambda entry: entry.name)}


def names(group: str) -> list[str]:
    """Returns the names registered in an entry point group, sorted."""
    return list(_installed(group))


@cache
def _load(group: str, name: str) -> Any:
    return _installed(group)[name].load()


def _find(group: str, name: str, field: str, kind: str) -> Any:
    if name not in _installed(group):
        remedy = f"installed: {', '.join(names(group)) or 'none'}"
        raise InvalidInputError(Problem(field, f"there is no {kind} {name!r}", remedy))
    return _load(group, name)


def driving_function(name: str, field: str = "driving_function") -> DrivingFunction:
    """Returns a driving function by name. Raises InvalidInputError listing the installed names."""
    return cast("DrivingFunction", _find("drivecal.driving_functions", name, field, "driving function"))


def vehicle(name: str, field: str = "vehicle.model") -> Vehicle:
    """Returns a vehicle model by name. Raises InvalidInputError listing the installed names."""
    return cast("Vehicle", _find("drivecal.vehicles", name, field, "vehicle model"))


def evaluator(name: str, field: str = "evaluator") -> Evaluator:
    """Returns a comfort evaluator by name. Raises InvalidInputError listing the installed names."""
    return cast("Evaluator", _find("drivecal.evaluators", name, field, "evaluator"))


def optimizer(name: str, field: str = "optimizer.kind") -> OptimizerPlugin:
    """Returns an optimizer by name. Raises InvalidInputError listing the installed names."""
    return cast("OptimizerPlugin", _find("drivecal.optimizers", name, field, "optimizer"))


def catalogue(name: str, field: str = "catalogue") -> Catalogue:
    """Returns a scenario catalogue by name. Raises InvalidInputError listing the installed names."""
    return cast("Catalogue", _find("drivecal.scenarios", name, field, "scenario catalogue"))


def catalogues() -> list[Catalogue]:
    """Returns all installed scenario catalogues."""
    return [catalogue(name) for name in names("drivecal.scenarios")]

"""The child of simulator kind `python`: imports a function of a file and serves it."""

import multiprocessing.connection
import sys
import zipfile
from collections.abc import Callable, Mapping
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from drivecal.adapters.driver import Evaluate, serve
from drivecal.adapters.inputs import record
from drivecal.domain.errors import InvalidInputError, Problem

MOST_BYTES = 4 << 30
"""Limit of the unpacked wheels."""


def prepare(settings: Mapping[str, Any]) -> Evaluate:
    """Imports the function. `settings`: `folder` (the bundle's), `section` (the manifest's), `packages` (where to unpack wheels), `opened`
    (where to record opened files, or None).
    """
    if settings["opened"] is not None:
        record(Path(settings["opened"]))
    section = settings["section"]
    function = function_of("simulator", section, Path(settings["folder"]), Path(settings["packages"]))

    def evaluate(request: Mapping[str, Any]) -> Mapping[str, Any]:
        seed = {"seed": request["seed"]} if section["random"] else {}
        return answer(function(request["parameters"], request["data"] | seed))

    return evaluate


def function_of(field: str, section: Mapping[str, Any], folder: Path, packages: Path) -> Callable[..., Any]:
    """Returns the function or class that a manifest's section names, in the file of a bundle, whose wheels are unpacked to `packages`.

    Its managers of shared objects listen on loopback, because Unix sockets are refused. Raises InvalidInputError if the file does not have
    it, and any exception of the file.
    """
    vars(multiprocessing.connection)["default_family"] = "AF_INET"
    if section.get("wheels") is not None:
        sys.path.insert(0, str(unpack(folder / section["wheels"], packages)))
    file = folder / section["file"]
    sys.path.insert(0, str(file.parent))
    function: Callable[..., Any] | None = getattr(imported(file), section["function"], None)
    if not callable(function):
        message = f"{file.name} has no function {section['function']}"
        raise InvalidInputError(Problem(f"{field}.function", message, "name one that the file has"))
    return function


def imported(file: Path) -> ModuleType:
    """Imports a file, which may be called like a module of the standard library."""
    spec = spec_from_file_location(file.stem, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file.name} is not a Python file")
    module = module_from_spec(spec)
    sys.modules.setdefault(file.stem, module)
    spec.loader.exec_module(module)
    return module


def answer(returned: object) -> Mapping[str, Any]:
    """Returns the answer that a function's result means: measures, perhaps with a `failure`, or a whole answer with `measures` in it."""
    if not isinstance(returned, Mapping):
        raise TypeError(f"the function returned {type(returned).__name__}, not a dict of measures")
    if isinstance(returned.get("failure"), str) or isinstance(returned.get("measures"), Mapping):
        whole = dict(returned)
        numbers = {name: value for name, value in _plain(returned).items() if type(value) in {int, float}}  # not bool
        whole["measures"] = numbers if whole.get("measures") is None else _plain(whole["measures"])
        if isinstance(whole.get("series"), Mapping):
            whole["series"] = {name: [_number(value) for value in values] for name, values in whole["series"].items()}
        return whole
    return {"measures": _plain(returned)}


def unpack(wheels: Path, packages: Path) -> Path:
    """Unpacks the wheels that fit this interpreter, once; returns the folder."""
    if packages.is_dir():
        return packages
    size = 0
    packages.mkdir(parents=True)
    for wheel in sorted(wheels.glob("*.whl")):
        if not fits(wheel.name):
            continue
        with zipfile.ZipFile(wheel) as archive:
            size += sum(entry.file_size for entry in archive.infolist())
            if size > MOST_BYTES:
                raise ValueError(f"the wheels take more than {MOST_BYTES >> 30} GB")
            archive.extractall(packages)
    return packages


def fits(name: str) -> bool:
    """Returns whether a wheel's tags fit this interpreter and machine. Raises ValueError for a name that no wheel may have."""
    from packaging.tags import sys_tags  # few simulators have wheels
    from packaging.utils import parse_wheel_filename

    return not parse_wheel_filename(name)[3].isdisjoint(sys_tags())


def _plain(measures: Mapping[str, Any]) -> dict[str, Any]:
    return {name: _number(value) for name, value in measures.items()}


def _number(value: Any) -> Any:
    """Converts numbers of other libraries, e.g. of numpy; its truth values and complex numbers are none."""
    is_number = getattr(getattr(value, "dtype", None), "kind", "f") in "iuf" and hasattr(value, "__float__")
    return float(value) if is_number and not isinstance(value, int) else value


if __name__ == "__main__":
    serve(prepare)

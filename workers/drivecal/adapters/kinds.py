"""The simulator kinds that run in child processes: each is a function that opens a session.

`process` and `command` start a program. `python` (a function in a file), `fmu` (an FMI 2 or 3 co-simulation FMU, run by FMPy) and `highway`
(a vehicle with a user's controller in SUMO) start a driver of drivecal's own, which speaks the protocol of `process`.
"""

import os
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from drivecal.adapters import inputs
from drivecal.adapters.children import check_command
from drivecal.adapters.command import CommandSession
from drivecal.adapters.environment import DRIVER, Scratch
from drivecal.adapters.process import ProcessSession
from drivecal.contracts.work import runs_in_worker
from drivecal.domain.errors import UnavailableError
from drivecal.plugins import registry, simulators
from drivecal.plugins.simulators import VERSIONS, Declared, Simulator, SimulatorSession, UnsuitableError
from drivecal.roads.network import network_file

UNFLUSHED = ", or let the program flush its standard output after each answer, if it does not"
"""Another cause of a run without an answer, of programs that users wrote: drivecal's own drivers flush."""
MOST_FMU_RUNS = 500
"""Runs of a child before another replaces it: FMPy has crashed after some thousand instantiations, and FMUs leak at every reset."""
MOST_HIGHWAY_RUNS = 2000
"""Runs of a child with SUMO, so that what SUMO or a controller leaks stays small."""
EXTRAS = {"libsumo": "local", "numba": "local", "fmpy": "fmu"}
"""Extra of drivecal that installs a module."""

Section = Mapping[str, Any]
Data = Mapping[str, Any]
Start = Callable[[Section, str, Mapping[str, Any], Scratch, Declared], SimulatorSession]


@dataclass(frozen=True, slots=True)
class _Kind:
    version: str
    start: Start

    def open(self, section: Section, scenario: str, data: Data, folder: Path, declared: Declared) -> SimulatorSession:
        """Starts a simulator in a scratch folder with links to the bundle's files, which is removed if that fails."""
        scratch = Scratch(folder)
        try:
            return self.start(section, scenario, data, scratch, declared)
        except BaseException:
            scratch.remove()
            raise


def simulator_of(section: Section) -> Simulator:
    """Returns the simulator of a manifest's section. Raises InvalidInputError if it is not installed, and UnavailableError if this system
    cannot hold child processes back."""
    kind = section["kind"]
    if runs_in_worker(section):
        return registry.simulator(kind)
    if sys.platform != "linux":
        raise UnavailableError(f"simulators of kind {kind} need Linux; this system is {sys.platform}")
    return _Kind(VERSIONS[kind], _START[kind])


def _refuse_missing(folder: Path, names: Iterable[str | None]) -> None:
    """Raises UnsuitableError if a file or folder is not in the bundle."""
    for name in names:
        if name is not None and not (folder / name).exists():
            raise UnsuitableError(f"{name} does not exist in the bundle")


def _refuse_without(*packages: str) -> None:
    """Raises UnavailableError if a package is not installed."""
    for package in packages:
        if find_spec(package) is None:
            raise UnavailableError(f"this worker has no {package}; type: pip install 'drivecal[{EXTRAS[package]}]'")


def _start_process(section: Section, scenario: str, data: Data, scratch: Scratch, declared: Declared) -> SimulatorSession:
    check_command(section["command"], scratch.work)
    return ProcessSession(section["command"], section, scratch, declared, scenario=scenario, data=data, advice=UNFLUSHED)


def _start_command(section: Section, _scenario: str, data: Data, scratch: Scratch, declared: Declared) -> SimulatorSession:
    """Checks that the command exists, which gets `data` as a file."""
    check_command(section["command"], scratch.work)
    return CommandSession(section, scratch, declared, data=data)


def _start_python(section: Section, scenario: str, data: Data, scratch: Scratch, declared: Declared) -> SimulatorSession:
    """Starts the interpreter and imports the function."""
    folder = scratch.bundle
    _refuse_missing(folder, (section["file"], section.get("wheels")))
    settings = {
        "folder": str(folder),
        "section": {key: section.get(key) for key in ("file", "function", "wheels", "random")},
        "packages": str(scratch.folder / "packages"),
        "opened": str(scratch.folder / inputs.NAME) if declared.watched else None,
    }
    command = [*DRIVER, "drivecal.adapters.python_driver"]
    return ProcessSession(command, section, scratch, declared, scenario=scenario, data=data, settings=settings)


def _start_fmu(section: Section, scenario: str, data: Data, scratch: Scratch, declared: Declared) -> SimulatorSession:
    """Starts the child, which unpacks, checks and instantiates the FMU."""
    folder = scratch.bundle
    _refuse_missing(folder, (section["file"],))
    _refuse_without("fmpy")
    settings = {
        "file": str(folder / section["file"]),
        "unpacked": str(scratch.folder / "fmu"),
        "section": {key: section.get(key) for key in ("duration", "step", "measures", "seed")},
        "series": list(declared.series),
        "data": dict(data),
    }
    driver = [*DRIVER, "drivecal.adapters.fmu_driver"]
    most = MOST_FMU_RUNS if section.get("reset", True) else 1
    return ProcessSession(driver, section, scratch, declared, scenario=scenario, data={}, most_runs=most, settings=settings)


def _start_highway(section: Section, scenario: str, data: Data, scratch: Scratch, declared: Declared) -> SimulatorSession:
    """Starts the child, which reads the network, loads SUMO and starts the controller."""
    folder, controller = scratch.bundle, section["controller"]
    has_fmu = controller["kind"] == "fmu"
    network = network_file(data["network"]) if "network" in data else None
    files = [controller.get(key) for key in ("file", "wheels")]
    _refuse_missing(folder, (network, data.get("routes"), data.get("openscenario"), *files))
    _refuse_without("libsumo", "numba", *(["fmpy"] if has_fmu else []))
    kernels = os.environ.get("NUMBA_CACHE_DIR")
    confinement = scratch.confinement()
    settings = {
        "folder": str(folder),
        "work": str(scratch.work),
        "scratch": str(scratch.folder),
        "simulator": dict(section),
        "scenario": scenario,
        "data": dict(data),
        "sumo": simulators.sumo(),
        "kernels": kernels,
        "changeable": None if confinement is None else confinement["writable"],
        "measures": list(declared.measures),
        "series": list(declared.series),
    }
    if controller["kind"] == "process":
        check_command(controller["command"], scratch.work)
    most_runs = MOST_FMU_RUNS if has_fmu else MOST_HIGHWAY_RUNS
    return ProcessSession(
        [*DRIVER, "drivecal.highway.drive.driver"],
        section,
        scratch,
        declared,
        scenario=scenario,
        data={},
        most_runs=most_runs if controller.get("reset", True) else 1,
        writable=_compiled(kernels),
        replays=True,
        settings=settings,
    )


def _compiled(folder: str | None) -> list[str]:
    """Returns the folders of numba's compiled kernels: numba neither stores nor loads them if it may not write there. The child gives up
    that right before it loads a user's code (`highway.drive.rehearsal`)."""
    if folder is not None:
        return [folder]
    highway = Path(__file__).parents[1] / "highway"
    return [str(path) for path in (highway, *highway.rglob("*/")) if path.name == "__pycache__"]


_START: Mapping[str, Start] = {
    "process": _start_process,
    "command": _start_command,
    "python": _start_python,
    "fmu": _start_fmu,
    "highway": _start_highway,
}

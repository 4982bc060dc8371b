"""Simulator kinds `python` and `fmu`, in children that speak the protocol of kind `process`.

`python` is a function in a file, in an interpreter of its own; `fmu` an FMI 2 or 3 co-simulation FMU, run by FMPy.
"""

import json
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from drivecal.adapters.children import Launch
from drivecal.adapters.process import ProcessSession
from drivecal.adapters.scratch import Scratch
from drivecal.bundles import units
from drivecal.domain.errors import UnavailableError
from drivecal.plugins.simulators import VERSIONS, Declared, UnsuitableError


class PythonAdapter:
    """Simulator kind `python`."""

    version = VERSIONS["python"]

    def open(
        self, section: Mapping[str, Any], scenario: str, data: Mapping[str, Any], folder: Path, declared: Declared
    ) -> ProcessSession:
        """Starts the interpreter and imports the function."""
        folder = folder.resolve()
        wheels = section.get("wheels")
        for name in (section["file"], *([] if wheels is None else [wheels])):
            if not (folder / name).exists():
                raise UnsuitableError(f"{name} does not exist in the bundle")
        scratch = Scratch(folder)
        settings = {
            "file": str(folder / section["file"]),
            "function": section.get("function", "evaluate"),
            "wheels": None if wheels is None else str(folder / wheels),
            "packages": str(scratch.folder / "packages"),
        }
        launch = Launch.of(driver_command("python_driver", settings), section)
        return ProcessSession(
            launch, scratch, declared, timeout=section["timeout"], scenario=scenario, data=data, blames_files=True
        )


def driver_command(module: str, settings: Mapping[str, Any]) -> list[str]:
    """Returns the command of one of drivecal's own drivers: without environment variables and user packages, and without writing bytecode
    into the bundle's folder."""
    return [sys.executable, "-I", "-B", "-m", f"drivecal.adapters.{module}", json.dumps(settings)]


MOST_RUNS = 500
"""Runs of a child before another replaces it: FMPy has crashed after some thousand instantiations, and FMUs leak at every reset."""


class FmuAdapter:
    """Simulator kind `fmu`."""

    version = VERSIONS["fmu"]

    def open(
        self, section: Mapping[str, Any], scenario: str, data: Mapping[str, Any], folder: Path, declared: Declared
    ) -> ProcessSession:
        """Starts the child, which unpacks, checks and instantiates the FMU."""
        file = folder.resolve() / section["file"]
        if not file.is_file():
            raise UnsuitableError(f"{section['file']} does not exist in the bundle")
        if find_spec("fmpy") is None:
            raise UnavailableError("this worker has no FMPy; type: pip install 'drivecal[fmu]'")
        scratch = Scratch(folder)
        settings = {
            "file": str(file),
            "unpacked": str(scratch.folder / "fmu"),
            "duration": section["duration"],
            "step": section["step"],
            "measures": dict(section["measures"]),
            "series": list(declared.series),
            "units": {name: unit for name, unit in declared.units.items() if unit not in units.WITHOUT},
            "data": dict(data),
            "parameters": dict(declared.parameters),
        }
        launch = Launch.of(driver_command("fmu_driver", settings), section)
        most_runs = MOST_RUNS if section.get("reset", True) else 1
        return ProcessSession(
            launch,
            scratch,
            declared,
            timeout=section["timeout"],
            scenario=scenario,
            data={},
            most_runs=most_runs,
            blames_files=True,
        )

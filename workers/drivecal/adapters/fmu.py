"""Simulator kind `fmu`: an FMI 2 or 3 co-simulation FMU, run by FMPy in a child that speaks the protocol of kind `process`."""

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from drivecal.adapters.children import Launch
from drivecal.adapters.process import ProcessSession
from drivecal.adapters.python import driver_command
from drivecal.adapters.scratch import Scratch
from drivecal.bundles import units
from drivecal.domain.errors import UnavailableError
from drivecal.plugins.simulators import VERSIONS, Declared, UnsuitableError

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

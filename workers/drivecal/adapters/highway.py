"""Simulator kind `highway`: a vehicle with a user's controller in SUMO, in a child that speaks the protocol of kind `process`."""

import json
import os
import sys
from collections.abc import Mapping
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from drivecal.adapters.children import Launch, check_command
from drivecal.adapters.process import ProcessSession
from drivecal.adapters.scratch import Scratch
from drivecal.domain.errors import UnavailableError
from drivecal.plugins import setups
from drivecal.plugins.simulators import VERSIONS, Declared, UnsuitableError
from drivecal.roads.network import network_file

EXTRAS = {"libsumo": "local", "numba": "local", "fmpy": "fmu"}
"""Extra of drivecal that installs a module; FMPy runs controllers and vehicles that are FMUs."""
MOST_RUNS = 2000
"""Runs of a child before another replaces it, so that what SUMO or a controller leaks stays small."""
MOST_FMU_RUNS = 500
"""The same for a controller that is an FMU, see `fmu`."""


class HighwayAdapter:
    """Simulator kind `highway`."""

    version = VERSIONS["highway"]

    def open(
        self, section: Mapping[str, Any], scenario: str, data: Mapping[str, Any], folder: Path, declared: Declared
    ) -> ProcessSession:
        """Starts the child, which reads the network, loads SUMO and starts the controller."""
        folder, controller = folder.resolve(), section["controller"]
        vehicle = section["vehicle"] if isinstance(section["vehicle"], Mapping) else {}
        has_fmu = "fmu" in (controller["kind"], vehicle.get("kind"))
        network = network_file(data["network"]) if "network" in data else None
        files = [entry.get(key) for entry in (controller, vehicle) for key in ("file", "wheels")]
        for name in (network, data.get("routes"), data.get("openscenario"), *files):
            if name is not None and not (folder / name).exists():
                raise UnsuitableError(f"{name} does not exist in the bundle")
        for package, extra in EXTRAS.items():
            if (has_fmu or package != "fmpy") and find_spec(package) is None:
                raise UnavailableError(f"this worker has no {package}; type: pip install 'drivecal[{extra}]'")
        scratch = Scratch(folder)
        confinement = scratch.confinement()
        settings = {
            "folder": str(folder),
            "work": str(scratch.work),
            "scratch": str(scratch.folder),
            "simulator": {"kind": "highway", **section},
            "scenario": scenario,
            "data": dict(data),
            "sumo": setups.sumo(),
            "kernels": os.environ.get("NUMBA_CACHE_DIR"),
            "changeable": None if confinement is None else confinement["writable"],
            "measures": list(declared.measures),
            "series": list(declared.series),
            "parameters": dict(declared.parameters),
        }
        try:
            for entry in (controller, vehicle):
                if entry.get("kind") == "process":
                    check_command(entry["command"], scratch.work)
            text = json.dumps(settings, allow_nan=False)
            file = scratch.keep("highway.json", text)  # may be larger than a command line
        except (UnavailableError, OSError):
            scratch.remove()
            raise
        # An earlier child can change the file; a later one refuses it then.
        command = [
            sys.executable,
            "-I",
            "-B",
            "-m",
            "drivecal.highway.drive.driver",
            str(file),
            sha256(text.encode()).hexdigest(),
        ]
        launch = Launch.of(command, section, _compiled(os.environ.get("NUMBA_CACHE_DIR")))
        most_runs = MOST_FMU_RUNS if has_fmu else MOST_RUNS
        if not all(entry.get("reset", True) for entry in (controller, vehicle)):
            most_runs = 1
        return ProcessSession(
            launch,
            scratch,
            declared,
            timeout=section["timeout"],
            scenario=scenario,
            data={},
            most_runs=most_runs,
            replays=True,
            blames_files=True,
        )


def _compiled(folder: str | None) -> list[str]:
    """Returns the folders of numba's compiled kernels: numba neither stores nor loads them if it may not write there. The child gives up
    that right before it loads a user's code (`highway.drive.rehearsal`)."""
    if folder is not None:
        return [folder]
    highway = Path(__file__).parents[1] / "highway"
    return [str(path) for path in (highway, *highway.rglob("*/")) if path.name == "__pycache__"]

"""Versions of SUMO and of drivecal's closed loop, which are part of setups. Read without importing either."""

from functools import cache
from importlib.metadata import PackageNotFoundError, version

CLOSED_LOOP = "4"
"""Version of the code that connects planner, vehicle and SUMO and measures the run (`drivecal.highway`).

Increase it whenever a run may change by a bit; `tests/golden` detects such changes.
"""


NO_SUMO = "libsumo not installed"


def sumo() -> str:
    """Returns SUMO's library and its version as installed now, without importing it."""
    try:
        return f"libsumo {version('libsumo')}"
    except PackageNotFoundError:
        return NO_SUMO


@cache
def simulator() -> str:
    """Returns the simulator and its version, without importing it, and the version of the closed loop."""
    library = sumo()
    return library if library == NO_SUMO else f"{library}, closed loop {CLOSED_LOOP}"

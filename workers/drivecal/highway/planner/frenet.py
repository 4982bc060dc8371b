"""Plug-in of the planner. Light: only `create` imports the kernels."""

from pathlib import Path

from drivecal.domain import roads
from drivecal.domain.scenarios import Scenario
from drivecal.domain.setups import digest
from drivecal.highway.planner.spaces import HIGHWAY, HIGHWAY_TABLE9, LIMITS
from drivecal.plugins.ports import DrivingFunction, Planner

_MODULES = ("candidates", "cost", "kernel", "lanes", "neighbours", "planner", "plans", "scratch", "terms")
ARITHMETIC = [Path(__file__).with_name(f"{name}.py") for name in _MODULES]
ON_CORRIDORS = [Path(__file__).with_name("following.py"), Path(__file__).parents[1] / "drive" / "trajectories.py"]
"""Further code that decides what the planner drives on a corridor."""


def version_of(code: bytes) -> str:
    """Returns the version of a planner with this code."""
    return f"1.{digest(code)[:8]}"


class Frenet:
    """The sampling planner in the Frenet frame (Werling et al. 2010) with the calibration parameters P1..P11."""

    name = "frenet"
    version = version_of(b"".join(path.read_bytes() for path in [*ARITHMETIC, Path(roads.__file__)]))
    """Digest of all code that decides what is driven, so that a changed magnitude never reuses earlier results."""

    def __init__(self) -> None:
        self.spaces = {"highway": HIGHWAY, "highway_table9": HIGHWAY_TABLE9}
        self.limits = dict(LIMITS)

    def create(self, scenario: Scenario) -> Planner:
        """Creates the planner for one scenario."""
        from drivecal.highway.planner.planner import FrenetPlanner  # numba is for workers only

        return FrenetPlanner(scenario)


FRENET: DrivingFunction = Frenet()


def corridor_version() -> str:
    """Returns the version of the planner as a controller on corridors."""
    return version_of(b"".join(path.read_bytes() for path in [*ARITHMETIC, Path(roads.__file__), *ON_CORRIDORS]))

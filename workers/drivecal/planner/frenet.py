"""Plug-in of the planner. Light: only `create` imports the kernels."""

from __future__ import annotations

from pathlib import Path

from drivecal.domain import roads
from drivecal.domain.scenarios import Scenario
from drivecal.domain.setups import digest
from drivecal.planner.spaces import HIGHWAY, HIGHWAY_TABLE9, LIMITS
from drivecal.plugins.ports import DrivingFunction, Planner

ARITHMETIC = [Path(__file__).with_name(name) for name in ("candidates.py", "cost.py", "kernel.py", "planner.py")]


class Frenet:
    """The sampling planner in the Frenet frame (Werling et al. 2010) with the calibration parameters P1..P11."""

    name = "frenet"
    version = "1." + digest(b"".join(path.read_bytes() for path in [*ARITHMETIC, Path(roads.__file__)]))[:8]
    """Digest of all code that decides what is driven, so that a changed magnitude never reuses earlier results."""
    certifiable = True

    def __init__(self) -> None:
        self.spaces = {"highway": HIGHWAY, "highway_table9": HIGHWAY_TABLE9}
        self.limits = dict(LIMITS)

    def create(self, scenario: Scenario) -> Planner:
        """Creates the planner for one scenario."""
        from drivecal.planner.planner import FrenetPlanner  # numba is for workers only

        return FrenetPlanner(scenario)


FRENET: DrivingFunction = Frenet()

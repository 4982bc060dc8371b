"""The planner as a plug-in. Light: the kernels are imported by `create` only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from drivecal.domain.parameters import Parameter
from drivecal.domain.scenarios import Scenario
from drivecal.planner.spaces import HIGHWAY, HIGHWAY_TABLE9, LIMITS
from drivecal.plugins.ports import Planner


@dataclass(frozen=True)
class Frenet:
    """The sampling planner in the Frenet frame (Werling et al. 2010) with the calibration parameters P1..P11."""

    name: str = "frenet"
    version: str = "1"
    spaces: Mapping[str, tuple[Parameter, ...]] = field(
        default_factory=lambda: {"highway": HIGHWAY, "highway_table9": HIGHWAY_TABLE9}
    )
    limits: Mapping[str, tuple[float | None, float | None]] = field(default_factory=lambda: LIMITS)
    certifiable: bool = True

    def create(self, scenario: Scenario) -> Planner:
        """The planner for one scenario."""
        from drivecal.planner.planner import FrenetPlanner  # numba is for workers only

        return FrenetPlanner(scenario)


FRENET = Frenet()

"""The planner as a plug-in: calibration parameters P1..P11 of the paper, as interpreted by drivecal, and the two built-in search spaces.

Light: only `create` imports the kernels.
"""

from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path

from drivecal.bundles.highway import Scenario
from drivecal.domain import roads
from drivecal.domain.parameters import Parameter
from drivecal.domain.setups import digest
from drivecal.plugins.ports import DrivingFunction, Planner

RANGES = (
    ("P1", "-15", "14", "0.5", 6, "dB", "smoothing: multiplies lateral and longitudinal jerk² by 10^(P1/10)"),
    ("P2", "0", "2", "0.01", 5, "1", "weight of lateral acceleration²"),
    ("P3", "0", "200", "1", 8, "1", "weight of the offset to the nearest lane centre, saturating beyond a metre"),
    ("P4", "0", "2000", "1", 11, "1", "weight of the heading relative to the road, squared"),
    ("P5", "0", "1500", "1", 4, "1", "weight of the deviation from the previous lateral plan, squared"),
    ("P6", "0", "1", "0.01", 4, "1", "weight of the time until the target lane is reached"),
    ("P7", "0", "200", "1", 8, "1", "weight of the shortfall of clear space around other vehicles"),
    ("P8", "0", "2000", "1", 11, "1", "weight of 1/TTC² to a vehicle ahead"),
    ("P9", "0", "10", "0.1", 5, "1", "weight of the shortfall of clear space to the lane boundary, squared"),
    ("P10", "0", "20", "0.1", 5, "1", "weight of (lateral closing speed / lateral gap)² to a neighbour"),
    ("P11", "0", "200", "1", 8, "1", "weight of 1/TTC² of a follower in the target lane"),
)
"""Name, lower, upper, step (Table 6), bits (of the lattice behind Table 9), unit, meaning."""

HIGHWAY = tuple(
    Parameter.from_step(name, Decimal(lower), Decimal(upper), Decimal(step), unit, meaning)
    for name, lower, upper, step, _, unit, meaning in RANGES
)

HIGHWAY_TABLE9 = tuple(
    Parameter.from_bits(name, Decimal(lower), Decimal(upper), bits, unit, meaning)
    for name, lower, upper, _, bits, unit, meaning in RANGES
)

LIMITS: Mapping[str, tuple[float | None, float | None]] = {
    name: (-60.0, 60.0) if unit == "dB" else (0.0, None) for name, *_, unit, _ in RANGES
}
"""Limits of user-defined spaces. A negative weight would reward undesired motion; beyond 60 dB, smoothing outweighs all other terms."""


_MODULES = ("cost", "kernel", "lanes", "planner", "plans", "terms")
ARITHMETIC = [Path(__file__).with_name(f"{name}.py") for name in _MODULES] + [Path(__file__).parents[1] / "geometry.py"]


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

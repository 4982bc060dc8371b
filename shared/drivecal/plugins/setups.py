"""Makes a setup from what is installed. Coordinator and workers both call it: equal fingerprints mean equal versions."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version

from drivecal.domain.scenarios import Scenario
from drivecal.domain.setups import Setup
from drivecal.plugins.ports import DrivingFunction, Vehicle

CLOSED_LOOP = "1"
"""Version of what puts planner, vehicle and SUMO together and measures the run (`drivecal.traffic`, `.episode`, `.comfort.metrics`):
counted up whenever a run may change by a bit. `tests/golden` notices."""


@cache
def simulator() -> str:
    """The simulator and its version, without importing it, with that of the closed loop around it."""
    try:
        return f"libsumo {version('libsumo')}, closed loop {CLOSED_LOOP}"
    except PackageNotFoundError:
        return "libsumo not installed"


def setup_of(
    scenario: Scenario, driving_function: DrivingFunction, vehicle: Vehicle, vehicle_parameters: Mapping[str, float]
) -> Setup:
    """The setup of one scenario. `vehicle_parameters` overrides nominal values by name."""
    nominal = {parameter.name: parameter.nominal for parameter in vehicle.parameters}
    return Setup(
        scenario=scenario.id,
        scenario_digest=scenario.digest,
        driving_function=driving_function.name,
        driving_function_version=driving_function.version,
        vehicle=vehicle.name,
        vehicle_version=vehicle.version,
        vehicle_parameters=nominal | {name: float(value) for name, value in vehicle_parameters.items()},
        simulator=simulator(),
        step_seconds=scenario.step,
        seed=scenario.seed,
    )

"""Setups of the installed plug-ins. Coordinator and workers both create them: equal fingerprints mean equal versions."""

from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version

from drivecal.domain.scenarios import Scenario
from drivecal.domain.setups import DrivenSetup
from drivecal.plugins.ports import DrivingFunction, Vehicle

CLOSED_LOOP = "3"
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


def setup_of(
    scenario: Scenario, driving_function: DrivingFunction, vehicle: Vehicle, vehicle_parameters: Mapping[str, float]
) -> DrivenSetup:
    """Creates the setup of one scenario. `vehicle_parameters` overrides nominal values by name."""
    nominal = {parameter.name: parameter.nominal for parameter in vehicle.parameters}
    return DrivenSetup(
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

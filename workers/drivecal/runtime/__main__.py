"""Compiles what workers need: `NUMBA_CACHE_DIR=FOLDER python -m drivecal.runtime`, once, where an image is made."""

from __future__ import annotations

from drivecal.contracts.work import Batch, Cell, SetupRequest
from drivecal.plugins import registry
from drivecal.plugins.setups import setup_of
from drivecal.runtime.worker import Worker


def trial(vehicle_name: str, evaluator_name: str) -> Batch:
    """One cell of drivecal's own plug-ins, the middle of the space in the first scenario: simulated, then remembered, certified by
    decisions, and often enough for its states to be described."""
    catalogue, function = registry.catalogue("highway"), registry.driving_function("frenet")
    vehicle, evaluator = registry.vehicle(vehicle_name), registry.evaluator(evaluator_name)
    name, scenario = next(iter(catalogue.scenarios.items()))
    setup = setup_of(scenario, function, vehicle, {})
    request = SetupRequest(
        catalogue=catalogue.name,
        scenario=name,
        driving_function=function.name,
        vehicle=vehicle.name,
        vehicle_parameters=setup.vehicle_parameters,
        evaluator=evaluator.name,
        run_fingerprint=setup.fingerprint,
    )
    space = next(iter(function.spaces.values()))
    middle = {parameter.name: float(parameter.value(parameter.n_values // 2)) for parameter in space}
    return Batch(request, (Cell(0, middle), *(Cell(number, middle, certify=True) for number in (1, 2, 3))))


if __name__ == "__main__":
    worker = Worker("compiles")
    for one in (trial("single_track", "reference"), trial("hybrid", "learned")):
        worker.warm(one)

"""Compiles the kernels of workers, once per image: `NUMBA_CACHE_DIR=FOLDER python -m drivecal.runtime`."""

from drivecal.contracts.work import Batch, Cell, DriveRequest
from drivecal.plugins import registry
from drivecal.plugins.setups import setup_of
from drivecal.runtime.worker import Worker


def trial(vehicle_name: str, evaluator_name: str) -> Batch:
    """Returns a batch for built-in plug-ins: the middle of the space in the first scenario."""
    catalogue, function = registry.catalogue("highway"), registry.driving_function("frenet")
    vehicle, evaluator = registry.vehicle(vehicle_name), registry.evaluator(evaluator_name)
    name, scenario = next(iter(catalogue.scenarios.items()))
    setup = setup_of(scenario, function, vehicle, {})
    request = DriveRequest(
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
    return Batch(request, (Cell(0, middle),))


if __name__ == "__main__":
    worker = Worker("compiles")
    for batch in (trial("single_track", "reference"), trial("hybrid", "learned")):
        worker.warm(batch)

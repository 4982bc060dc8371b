"""Compiles the kernels of workers, once per image: `NUMBA_CACHE_DIR=FOLDER python -m drivecal.runtime`."""

from drivecal.bundles.fingerprints import setup_document
from drivecal.bundles.highway import TaskScenario
from drivecal.bundles.installed import installed_problems
from drivecal.contracts.work import Batch, Cell, SetupRequest
from drivecal.domain.setups import fingerprint_of
from drivecal.plugins import registry
from drivecal.runtime.worker import Worker


def trial(vehicle_name: str, evaluator_name: str) -> Batch:
    """Returns a batch for built-in plug-ins: the middle of the space in the first scenario."""
    problem = installed_problems()["highway"]
    manifest, vehicle = problem.manifest, registry.vehicle(vehicle_name)
    name, declared = next(iter(manifest.scenarios.items()))
    data = TaskScenario.model_validate(declared).model_dump(mode="json")
    section = manifest.simulator.model_dump(mode="json") | {"vehicle": vehicle.name}
    varied = {parameter.name: parameter.nominal for parameter in vehicle.parameters}
    document = setup_document(manifest, name, problem.files, section=section, data=data, varied=varied)
    request = SetupRequest(
        bundle=problem.digest,
        problem=manifest.problem,
        scenario=name,
        data=data,
        simulator=section,
        parameters=tuple(manifest.scalars),
        integers=(),
        shapes={},
        measures=tuple(manifest.measures),
        failures=manifest.failures,
        series=(),
        run_fingerprint=fingerprint_of(document),
        document=document,
        varied=varied,
        evaluator=evaluator_name,
        is_driven=True,
    )
    middle = {name: ((entry.lower or 0.0) + (entry.upper or 0.0)) / 2 for name, entry in manifest.scalars.items()}
    return Batch(request, (Cell(0, middle),))


if __name__ == "__main__":
    worker = Worker("compiles")
    for batch in (trial("single_track", "reference"), trial("hybrid", "learned")):
        worker.warm(batch)

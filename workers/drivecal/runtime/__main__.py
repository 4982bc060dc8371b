"""Compiles the kernels of workers, once per image: `NUMBA_CACHE_DIR=FOLDER python -m drivecal.runtime`."""

from drivecal.bundles.installed import installed_problems
from drivecal.plugins import registry
from drivecal.plugins.simulators import Declared
from drivecal.runtime.compilation import prepare_cache


def compile_kernels(vehicle: str, evaluator: str | None) -> None:
    """Drives the middle of the built-in motorway's space in its first scenario, rated by an evaluator that needs time series."""
    manifest = installed_problems()["highway"].manifest
    name, data = next(iter(manifest.scenarios.items()))
    section = manifest.simulator.model_dump(mode="json") | {"vehicle": vehicle}
    declared = Declared(manifest.problem, tuple(manifest.measures), evaluator=evaluator)
    session = registry.simulator("highway").open(section, name, data, registry.problems()["highway"], declared)
    session.evaluate({name: ((entry.lower or 0.0) + (entry.upper or 0.0)) / 2 for name, entry in manifest.scalars.items()})


if __name__ == "__main__":
    prepare_cache()
    compile_kernels("single_track", None)
    compile_kernels("hybrid", "learned")

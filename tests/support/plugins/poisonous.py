"""A user's package with a driving function that keeps lane and speed, but for a few values of `dose`, which really break the worker:
a null pointer inside libsumo, a call that does not return, memory that runs out. Found as `misbehaving` is."""

import resource
import time
from collections.abc import Mapping, Sequence
from decimal import Decimal
from pathlib import Path

import numpy as np

from drivecal.bundles.highway import Scenario
from drivecal.domain.parameters import Parameter
from drivecal.plugins.ports import Floats, Observation

DOSES = 16
SEGFAULT, HANG, MEMORY = 3, 7, 11
"""Doses that kill; all others are harmless."""
MEMORY_LEFT = 64 * 2**20
"""Bytes that a process may still take when it is made to run out of memory."""


class Swallow:
    """Straight on; good for straight roads."""

    period = 1.0

    def __init__(self) -> None:
        self._dose = 0.0

    def reset(self, parameters: Sequence[float]) -> None:
        (self._dose,) = parameters

    def plan(self, observation: Observation) -> Floats:
        if self._dose == SEGFAULT:
            crash_libsumo()
        if self._dose == HANG:
            time.sleep(3600)
        if self._dose == MEMORY:
            run_out_of_memory()
        s, speed, _, d, _, _ = observation.ego.tolist()
        times = np.arange(0.0, 2.05, 0.1)
        trajectory = np.zeros((len(times), 7))
        trajectory[:, 0] = times
        trajectory[:, 1] = s + speed * times
        trajectory[:, 2] = d
        trajectory[:, 5] = speed
        return trajectory


def crash_libsumo() -> None:
    """Asks the running simulation for the neighbours of a vehicle that is on no lane yet: libsumo 1.28 follows a null pointer."""
    import libsumo

    libsumo.route.add("nowhere", libsumo.edge.getIDList()[:1])
    libsumo.vehicle.add("ghost", "nowhere", depart="1000000")
    libsumo.vehicle.getNeighbors("ghost", 1)


def run_out_of_memory() -> None:
    """Takes memory until the system gives no more, which is made to happen soon. Raises MemoryError."""
    limits = resource.getrlimit(resource.RLIMIT_AS)
    taken = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY_LEFT, limits[1]))
    try:
        hoard = []
        while True:
            hoard.append(bytearray(2**20))
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)


class Poisonous:
    """The plug-in."""

    name = "poisonous"
    version = "1"
    spaces: Mapping[str, tuple[Parameter, ...]] = {
        "all": (Parameter.from_step("dose", Decimal(0), Decimal(DOSES - 1), Decimal(1)),)
    }
    limits: Mapping[str, tuple[float | None, float | None]] = {}

    def create(self, scenario: Scenario) -> Swallow:
        del scenario
        return Swallow()


POISONOUS = Poisonous()

"""A user's package with two driving functions, which keep lane and speed: `misbehaving` breaks as its parameter `behaviour` says, and a few
values of the `dose` of `poisonous` really break the worker: a null pointer inside libsumo, a call that does not return, no memory.

Found like any installed package once this folder is on the path: its entry points are in the dist-info folder next to it.
"""

import os
import resource
import time
from collections.abc import Mapping, Sequence
from decimal import Decimal
from pathlib import Path

import numpy as np

from drivecal.bundles.highway import Scenario
from drivecal.domain.parameters import Parameter
from drivecal.plugins.ports import Floats, Observation

CRASH, HANG, ERROR, MEMORY = 1.0, 2.0, 3.0, 4.0
MEMORY_LEFT = 64 * 2**20
"""Bytes that a process may still take when it is made to run out of memory."""


class KeepGoing:
    """Straight on; good for straight roads."""

    period = 1.0

    def __init__(self) -> None:
        self._behaviour = 0.0

    def reset(self, parameters: Sequence[float]) -> None:
        self._behaviour, _ = parameters

    def plan(self, observation: Observation) -> Floats:
        if self._behaviour == CRASH:
            os._exit(1)
        if self._behaviour == HANG:
            time.sleep(3600)
        if self._behaviour == ERROR:
            raise ValueError("as asked for")
        if self._behaviour == MEMORY:
            raise MemoryError
        s, speed, _, d, _, _ = observation.ego.tolist()
        times = np.arange(0.0, 2.05, 0.1)
        trajectory = np.zeros((len(times), 7))
        trajectory[:, 0] = times
        trajectory[:, 1] = s + speed * times
        trajectory[:, 2] = d
        trajectory[:, 5] = speed
        return trajectory


class Misbehaving:
    """The plug-in."""

    name = "misbehaving"
    version = "1"
    spaces: Mapping[str, tuple[Parameter, ...]] = {
        "all": (
            Parameter.from_step("behaviour", Decimal(0), Decimal(4), Decimal(1)),
            Parameter.from_step("value", Decimal(0), Decimal(10), Decimal(1)),
        )
    }
    limits: Mapping[str, tuple[float | None, float | None]] = {}

    def create(self, scenario: Scenario) -> KeepGoing:
        del scenario
        return KeepGoing()


class Swallow(KeepGoing):
    """Takes a dose."""

    def reset(self, parameters: Sequence[float]) -> None:
        (self._dose,) = parameters

    def plan(self, observation: Observation) -> Floats:
        if self._dose == Poisonous.SEGFAULT:
            crash_libsumo()
        if self._dose == Poisonous.HANG:
            time.sleep(3600)
        if self._dose == Poisonous.MEMORY:
            run_out_of_memory()
        return super().plan(observation)


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


class Poisonous(Misbehaving):
    """The plug-in. Its other doses are harmless."""

    DOSES, SEGFAULT, HANG, MEMORY = 16, 3, 7, 11
    name = "poisonous"
    spaces: Mapping[str, tuple[Parameter, ...]] = {
        "all": (Parameter.from_step("dose", Decimal(0), Decimal(DOSES - 1), Decimal(1)),)
    }

    def create(self, scenario: Scenario) -> KeepGoing:
        del scenario
        return Swallow()


MISBEHAVING, POISONOUS = Misbehaving(), Poisonous()

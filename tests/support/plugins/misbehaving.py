"""A user's package with a driving function: it keeps lane and speed, or breaks as its parameter `behaviour` says.

Found like any installed package once this folder is on the path: its entry point is in the dist-info folder next to it.
"""

import os
import time
from collections.abc import Mapping, Sequence
from decimal import Decimal

import numpy as np

from drivecal.bundles.highway import Scenario
from drivecal.domain.parameters import Parameter
from drivecal.plugins.ports import Floats, Observation

CRASH, HANG, ERROR, MEMORY = 1.0, 2.0, 3.0, 4.0


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


MISBEHAVING = Misbehaving()

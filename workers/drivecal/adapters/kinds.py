"""The simulator kinds that run in child processes."""

import sys
from collections.abc import Mapping
from types import MappingProxyType

from drivecal.adapters.command import CommandAdapter
from drivecal.adapters.highway import HighwayAdapter
from drivecal.adapters.process import ProcessAdapter
from drivecal.adapters.python import FmuAdapter, PythonAdapter
from drivecal.domain.errors import NotFoundError, UnavailableError
from drivecal.plugins.simulators import Simulator

_SIMULATORS: Mapping[str, Simulator] = MappingProxyType(
    {
        "process": ProcessAdapter(),
        "command": CommandAdapter(),
        "python": PythonAdapter(),
        "fmu": FmuAdapter(),
        "highway": HighwayAdapter(),
    }
)


def simulator(kind: str) -> Simulator:
    """Returns the simulator of a kind. Raises NotFoundError, and UnavailableError if this system cannot hold child processes back."""
    if kind not in _SIMULATORS:
        raise NotFoundError("simulator kind", kind, f"there are {', '.join(_SIMULATORS)}")
    if sys.platform != "linux":
        raise UnavailableError(f"simulators of kind {kind} need Linux; this system is {sys.platform}")
    return _SIMULATORS[kind]

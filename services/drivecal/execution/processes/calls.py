"""Messages between a coordinator and the process of a worker, whose own module runs as `__main__` and could not be pickled by name."""

import struct
from dataclasses import dataclass
from typing import Any

START = struct.Struct("<qq")
"""A start of a simulator, as a worker writes it into a file of the coordinator: the numbers of the call and of the cell."""


@dataclass(frozen=True, slots=True)
class RemoteCall:
    """A call of a method of `drivecal.runtime.worker.Worker`. Number 0 wants no answer."""

    number: int
    method: str
    arguments: tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class RemoteAnswer:
    """The value of a call, or the description of its error."""

    number: int
    value: Any
    error: str | None = None

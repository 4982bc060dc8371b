"""Pace of simulations: the time of one, and the workers that share them, for estimates before anything is submitted."""

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import Connection

from drivecal.api.live.dispatcher_health import judge
from drivecal.storage import processes
from drivecal.storage.engine.types import now
from drivecal.storage.references import runs

ASSUMED_MILLISECONDS = 8.0
"""CPU time of one simulation in the built-in scenarios, on a machine of today."""


@dataclass(frozen=True, slots=True)
class Pace:
    """A simulation occupies a worker for so many `milliseconds`, `measured` in these setups or else assumed; `workers`: None if the
    dispatcher is silent."""

    milliseconds: float
    measured: bool
    workers: int | None

    def seconds(self, simulations: int) -> float | None:
        """Returns the time of so many simulations; None without workers."""
        return None if self.workers is None else simulations * self.milliseconds / 1000 / self.workers


def pace(connection: Connection, fingerprints: Sequence[str]) -> Pace:
    """Returns the pace of simulations in the setups with these fingerprints."""
    measured = runs.recent_milliseconds(connection, fingerprints)
    dispatcher = processes.read(connection, processes.DISPATCHER)
    workers = None
    if dispatcher is not None and not judge(dispatcher, now()).silent:
        workers = len(dispatcher.detail.get("workers", [])) or None
    return Pace(measured or ASSUMED_MILLISECONDS, measured is not None, workers)

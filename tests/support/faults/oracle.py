"""Results of campaigns without faults: this process simulates one cell after the other, without a server, Ray or workers."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tests.support.computed import ComputedBackend
from tests.support.faults.findings import Found, assert_sound, found
from tests.support.faults.workload import submit
from tests.support.runs import dispatcher
from tests.support.server import serving

from drivecal.execution.backend import Finished, Lost
from drivecal.runtime.worker import Worker
from drivecal.storage import campaigns

PATIENCE_SECONDS = 900.0


class InThisProcess(ComputedBackend):
    """The `Backend` that has no other process: a batch is simulated when its answer is asked for."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._worker = Worker(self._name)

    def wait(self, timeout: float) -> list[Finished | Lost]:
        del timeout
        first, self._outstanding = self._outstanding[:1], self._outstanding[1:]
        return [Finished(number, self._worker.run(batch)) for number, batch in first]

    def replace(self, worker: str, fault: str | None) -> None:
        raise AssertionError(f"{worker} is to be replaced: {fault}")


def undisturbed(folder: Path) -> dict[str, Found]:
    """Returns what the suite's campaigns find, by name; on SQLite. AssertionError where they would not show what they are there to show."""
    results = carried_out(folder)
    counts = results["reusing"].campaign["stages"]["calibration"]
    assert min(counts[name] for name in ("repeated", "reused", "simulated", "audited", "carried_over")) > 0, counts
    assert len({row["score"] for row in results["reusing"].tables["evaluations"]}) >= 3
    assert results["analysing"].campaign["stages"]["sensitivity"]["simulated"] > 50
    return results


def carried_out(folder: Path, documents: Mapping[str, Mapping[str, Any]] | None = None) -> dict[str, Found]:
    """Returns the results of campaigns by name, on SQLite. Without `documents` it runs the campaigns of the suite."""
    with serving(f"sqlite:///{folder / 'drivecal.db'}") as api:
        accepted = submit(api.url, documents)
        one = dispatcher(api.database, InThisProcess())
        left = set(accepted.campaigns.values())
        begin = time.monotonic()
        while left:
            one.step()
            with api.database.read() as connection:
                left = {identifier for identifier in left if not campaigns.get(connection, identifier).state.ended}
            assert time.monotonic() - begin < PATIENCE_SECONDS, f"{left} do not end"
        assert_sound(api, accepted)
        return {name: found(api, identifier) for name, identifier in accepted.campaigns.items()}

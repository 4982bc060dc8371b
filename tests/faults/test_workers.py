"""Workers that are killed from outside, again and again."""

import random
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
from tests.support.faults.coordinator import Coordinator, coordinator
from tests.support.faults.lives import assert_as_without_faults, has_ended, wait_until_ended
from tests.support.faults.oracle import carried_out
from tests.support.faults.workload import Accepted, submit

from drivecal.domain.errors import DrivecalError

EVERY_SECONDS = 2.0
FOR_SECONDS = 180.0
LEAST = 30
"""Smallest number of killed workers: a worker cannot be killed while it starts, which takes long on a busy machine."""
PATIENCE_SECONDS = 900.0
UNREDUCED: dict[str, Any] = {
    "sensitivity": None,
    "optimizer": {"kind": "genetic", "population": 100, "iterations": 6, "seed": 5},
    "reduction": {"mode": "off"},
}


@contextmanager
def _murderer(server: Coordinator, seed: int) -> Iterator[list[int]]:
    """Kills one worker every two seconds while the block lasts; gives the process ids of the killed, as they come."""
    stop, killed, chance = threading.Event(), list[int](), random.Random(seed)

    def work() -> None:
        while not stop.wait(EVERY_SECONDS):
            with suppress(DrivecalError, psutil.NoSuchProcess):
                if workers := server.workers():
                    victim = chance.choice(workers)
                    victim.kill()
                    killed.append(victim.pid)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield killed
    finally:
        stop.set()
        thread.join()


@pytest.mark.faults
@pytest.mark.timeout(3600)
def test_a_worker_killed_every_two_seconds_for_three_minutes_costs_no_cell(tmp_path: Path, base_seed: int) -> None:
    expected = carried_out(tmp_path, {"unreduced": UNREDUCED})
    print(f"seed {base_seed}; {len(expected['unreduced'].tables['evaluations'])} cells in a campaign")
    with coordinator(tmp_path / "server") as server:
        server.start_ready()
        submitted: list[Accepted] = []
        begin = time.monotonic()
        with _murderer(server, base_seed) as killed:

            def over() -> bool:
                return time.monotonic() - begin > FOR_SECONDS and len(killed) >= LEAST

            while not over():
                submitted.append(submit(server.url, {"unreduced": UNREDUCED}))
                server.until(lambda: over() or has_ended(server, submitted[-1]), "the end of a campaign", PATIENCE_SECONDS)
                print(f"{time.monotonic() - begin:.0f} s: campaign {len(submitted)}, {len(killed)} killed", flush=True)
        for accepted in submitted:
            wait_until_ended(server, accepted)
        for accepted in submitted:  # this looks at the whole database: nothing of a later one may be under way
            assert_as_without_faults(server, accepted, expected)
        server.wait_ready()
        print(f"SIGTERM ended it in {server.terminate()}")

"""Workers that are killed from outside, again and again."""

from __future__ import annotations

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
from tests.support.faults.findings import assert_sound, found
from tests.support.faults.lives import assert_as_without_faults, wait_until_ended
from tests.support.faults.workload import submit

from drivecal.domain.errors import DrivecalError

EVERY_SECONDS = 2.0
FOR_SECONDS = 180.0
UNREDUCED: dict[str, Any] = {
    "sensitivity": None,
    "optimizer": {"kind": "genetic", "population": 100, "iterations": 6, "seed": 5},
    "reduction": {"mode": "off", "certified": False},
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
    with coordinator(tmp_path / "without-faults") as server:
        server.start_ready()
        accepted = submit(server.url, {"unreduced": UNREDUCED})
        wait_until_ended(server, accepted, 600)
        assert_sound(server, accepted)
        expected = {"unreduced": found(server, accepted.campaigns["unreduced"])}
        server.terminate()
    print(f"seed {base_seed}; {len(expected['unreduced'].tables['evaluations'])} cells in a campaign")
    with coordinator(tmp_path / "with") as server:
        server.start_ready()
        campaigns = 0
        with _murderer(server, base_seed) as killed:
            begin = time.monotonic()
            while time.monotonic() - begin < FOR_SECONDS:
                accepted = submit(server.url, {"unreduced": UNREDUCED})
                wait_until_ended(server, accepted, 900)
                assert_as_without_faults(server, accepted, expected)
                campaigns += 1
                print(f"{time.monotonic() - begin:.0f} s: {campaigns} campaigns, {len(killed)} workers killed", flush=True)
        assert len(killed) >= FOR_SECONDS / EVERY_SECONDS / 3, f"only {len(killed)} workers were there to be killed"
        server.wait_ready()
        server.terminate()

"""The head of a Ray cluster goes down and comes back."""

import time
from pathlib import Path

import httpx
import pytest
from tests.support.faults.coordinator import Coordinator, coordinator
from tests.support.faults.findings import Found
from tests.support.faults.lives import SAID_SECONDS, Moment, live
from tests.support.faults.ray_head import ray_head

DOWN_SECONDS = 90.0


def _degraded(server: Coordinator) -> str | None:
    """Returns what the first campaign that runs says of itself."""
    answer = server.answers("/api/v1/campaigns?state=running")
    if answer is None or answer.status_code != httpx.codes.OK:
        return None
    return next((str(item["degraded"]) for item in answer.json()["items"] if item["degraded"]), None)


@pytest.mark.faults
@pytest.mark.timeout(3600)
def test_a_ray_head_is_down_for_ninety_seconds(tmp_path: Path, without_faults: dict[str, Found]) -> None:
    with (
        ray_head() as head,
        coordinator(tmp_path, settings={"DRIVECAL_RAY_ADDRESS": head.address, **head.environment}) as server,
    ):

        def head_down(coordinator: Coordinator) -> None:
            head.kill()
            begin = time.monotonic()
            took = coordinator.until(lambda: _degraded(coordinator) is not None, "a campaign that is degraded", SAID_SECONDS)
            print(f"         degraded after {took}: {_degraded(coordinator)}", flush=True)
            while time.monotonic() - begin < DOWN_SECONDS:
                health = coordinator.answers("/healthz")
                assert health is not None
                assert health.status_code == httpx.codes.OK
                time.sleep(1.0)
            assert _degraded(coordinator) is not None
            head.start()
            print(f"         ready again {coordinator.wait_ready()} after the head", flush=True)

        live(server, [(Moment(0.3, 0.0), head_down)], without_faults)

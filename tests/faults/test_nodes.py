"""Nodes of a Ray cluster come and go while a campaign runs. Several on this machine, by Ray's own means."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.support.faults.coordinator import Coordinator, coordinator
from tests.support.faults.findings import assert_equal, assert_sound, found
from tests.support.faults.lives import wait_until_ended
from tests.support.faults.oracle import carried_out
from tests.support.faults.workload import REUSING, submit

from drivecal.cluster.settings import ALERT, OBJECT_STORE_BYTES, QUIET, VERSION_LABEL

LONG = {
    "long": REUSING
    | {
        "name": "long",
        "optimizer": {"kind": "genetic", "population": 600, "iterations": 12, "seed": 4, "mutation": 1},
        "reduction": {"mode": "exact"},
    }
}
"""Lasts until a node that comes later has started, worked and lost its neighbour."""
START_SECONDS = 120.0
NOTICED_SECONDS = 10.0
"""Longest time until the server notices a lost node and gives its cells to others."""
SETTINGS = {"RAY_AUTH_MODE": "disabled", "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", **QUIET, **ALERT}
"""The second variable makes Ray listen on 127.0.0.1 only, on Linux as well."""


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A head without workers; nodes are added and removed."""
    for name, value in SETTINGS.items():
        monkeypatch.setenv(name, value)
    from ray.cluster_utils import Cluster  # reads the environment

    head = {
        "num_cpus": 0,
        "object_store_memory": OBJECT_STORE_BYTES,
        "include_dashboard": False,
        "node_ip_address": "127.0.0.1",
    }
    running: Any = Cluster(initialize_head=True, head_node_args=head)
    yield running
    running.shutdown()


def workers(server: Coordinator) -> dict[str, dict[str, Any]]:
    """As the API shows them, by name."""
    answer = server.answers("/api/v1/workers")
    return {} if answer is None else {worker["id"]: worker for worker in answer.json()["items"]}


def problems(server: Coordinator) -> str:
    answer = server.answers("/readyz")
    return "" if answer is None else " ".join(answer.json()["problems"])


def cells(server: Coordinator, name: str) -> int:
    return int(workers(server).get(name, {"cells": 0})["cells"])


def add(cluster: Any, **more: Any) -> Any:
    return cluster.add_node(num_cpus=1, object_store_memory=OBJECT_STORE_BYTES, node_ip_address="127.0.0.1", **more)


@pytest.mark.faults
@pytest.mark.timeout(1200)
def test_nodes_come_and_go_in_a_campaign_and_nothing_changes(tmp_path: Path, cluster: Any) -> None:
    (tmp_path / "undisturbed").mkdir()
    undisturbed = carried_out(tmp_path / "undisturbed", LONG)
    settings = {"DRIVECAL_RAY_ADDRESS": cluster.address, "DRIVECAL_WORKERS": "", **SETTINGS}
    with coordinator(tmp_path, settings=settings) as server:
        server.start()
        server.until(lambda: "has no node with workers; start some" in problems(server), "that nobody works", START_SECONDS)
        first = add(cluster)
        server.wait_ready()
        assert list(workers(server)) == ["worker-1"]
        accepted = submit(server.url, LONG)
        server.until(lambda: cells(server, "worker-1") > 0, "work for the first node", START_SECONDS)

        add(cluster)
        server.until(lambda: cells(server, "worker-2") > 0, "work for a node that came later", START_SECONDS)
        cluster.remove_node(first, allow_graceful=False)
        took = server.until(lambda: "worker-1" not in workers(server), "that a node is gone", NOTICED_SECONDS)
        print(f"\n         a lost node was gone from the workers after {took}", flush=True)

        add(cluster, labels={VERSION_LABEL: "0.0.1"})
        server.until(
            lambda: "has drivecal 0.0.1; install the same release on both" in problems(server),
            "that a version is refused",
            START_SECONDS,
        )
        assert list(workers(server)) == ["worker-2"]
        wait_until_ended(server, accepted)
        assert_sound(server, accepted)
        assert_equal("long", found(server, accepted.campaigns["long"]), undisturbed["long"])
        assert cells(server, "worker-2") > 0
        server.terminate()

"""The cluster as a user runs it: built, used, broken, scaled and restored on a real Docker engine. `make test-compose`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
from tests.support.compose import PROJECT_NAME, Cluster
from tests.support.faults.coordinator import coordinator
from tests.support.faults.findings import Found, assert_equal, found
from tests.support.faults.lives import wait_until_ended
from tests.support.faults.workload import Accepted, post
from tests.support.server import RunningApi, serving

pytestmark = [pytest.mark.compose, pytest.mark.timeout(3600)]

NOTICED_SECONDS = 10.0
SCENARIOS = [f"S{number}" for number in range(1, 7)]
FINE: list[dict[str, Any]] = [{"name": f"P{number}", "lower": 0, "upper": 1, "step": 0.05} for number in range(1, 7)]
BOLD_MAP: dict[str, Any] = {
    "parameters": FINE,
    "catalogue": SCENARIOS,
    "scenarios": {name: {parameter: {"influential": False} for parameter in ("P5", "P6")} for name in SCENARIOS},
}
CAMPAIGN: dict[str, Any] = {
    "name": "in the cluster",
    "catalogue": SCENARIOS,
    "parameters": FINE,
    "fixed": {f"P{number}": 0.5 for number in range(7, 12)},
    "optimizer": {"kind": "genetic", "population": 1000, "iterations": 12, "seed": 11, "mutation": 1},
    "reduction": {"audit": 0.2, "max_error": 1, "certified": False},
}
"""Every way to an answer but certificates, and long enough (two minutes on two idle cores) for what is done to the cluster meanwhile."""
KILL = """
import os, pathlib, signal
for process in pathlib.Path("/proc").glob("[0-9]*"):
    if (process / "cmdline").read_bytes().startswith(b"ray::Worker"):
        os.kill(int(process.name), signal.SIGKILL)
"""
"""Kills the simulating process of a node; the image has no tool for that."""


def test_only_the_api_can_be_reached_and_it_wants_a_token(cluster: Cluster) -> None:
    published = cluster.published()
    assert published.pop("api") == {int(cluster.url.rpartition(":")[2])}
    assert set().union(*published.values()) == set()
    assert cluster.http.get("/api/v1/campaigns", headers={"Authorization": ""}).status_code == 401
    assert cluster.http.get("/api/v1/campaigns").status_code == 200


def test_nothing_of_ours_runs_as_root_or_can_write_to_its_image(cluster: Cluster) -> None:
    for service in ("api", "dispatcher", "ray-head", "ray-worker"):
        assert cluster.compose("exec", "-T", service, "id", "-u").strip() == "10001"
        refused = cluster.compose("exec", "-T", service, "touch", "/opt/drivecal/x", check=False)
        assert "Read-only file system" in refused


def test_four_nodes_are_there_each_with_a_worker(cluster: Cluster) -> None:
    cluster.until(lambda: len(cluster.ready_nodes()) == 4, "four nodes with a worker")
    assert {worker["node"] for worker in cluster.workers()} == {one[:12] for one in cluster.containers("ray-worker")}


@pytest.fixture(scope="module")
def embedded(tmp_path_factory: pytest.TempPathFactory) -> Found:
    """What the campaign finds with `drivecal serve` on SQLite, in this environment."""
    with coordinator(tmp_path_factory.mktemp("embedded")) as server:
        server.start_ready()
        identifier = post(server.url, "/api/v1/campaigns", with_map(post(server.url, "/api/v1/influence-maps", BOLD_MAP)))
        wait_until_ended(server, Accepted({"in the cluster": identifier}), 1800.0)
        result = found(server, identifier)
        server.terminate()
    return result


def with_map(map_id: str) -> dict[str, Any]:
    return CAMPAIGN | {"sensitivity": {"map": map_id}}


def backup(cluster: Cluster, to: Path) -> None:
    """Copies the database out of the cluster while it works."""
    cluster.compose("exec", "-T", "api", "drivecal", "db", "backup", "--force", "/backups/drivecal.db")
    cluster.compose("cp", "api:/backups/drivecal.db", str(to))


def test_a_campaign_survives_whatever_is_done_to_the_cluster_and_finds_what_it_finds_embedded(
    cluster: Cluster, embedded: Found, tmp_path: Path
) -> None:
    map_id = cluster.http.post("/api/v1/influence-maps", json=BOLD_MAP).raise_for_status().json()["id"]
    identifier = cluster.http.post("/api/v1/campaigns", json=with_map(map_id)).raise_for_status().json()["id"]
    path = f"/api/v1/campaigns/{identifier}"

    def simulated() -> int:
        return int(cluster.get(path)["cells"]["simulated"])

    def still_running(more: int = 20) -> None:
        """It is under way, and gets on."""
        before = simulated()
        cluster.until(lambda: simulated() > before + more, "further cells")
        assert cluster.get(path)["state"] == "running"

    size = database_bytes(cluster)
    still_running()
    victim, other, *_ = cluster.containers("ray-worker")
    cluster.run("docker", "exec", victim, "python", "-c", KILL)
    still_running()
    cluster.run("docker", "kill", other)
    took = cluster.until(lambda: other[:12] not in {one["node"] for one in cluster.workers()}, "a lost node to be noticed")
    print(f"a lost node was noticed within {took:.1f} s", flush=True)
    assert took < NOTICED_SECONDS
    still_running()
    cluster.compose("up", "-d", "--no-recreate", "--scale", "ray-worker=6")
    took = cluster.until(lambda: len(cluster.ready_nodes()) == 6, "six nodes at work")
    print(f"six nodes were at work after {took:.0f} s", flush=True)
    still_running()
    cluster.compose("restart", "--timeout", "10", "dispatcher")
    still_running()
    cluster.compose("restart", "--timeout", "10", "db")
    still_running(0)
    cluster.run(
        "docker", "exec", cluster.containers("ray-worker")[-1], "python", "-c", KILL.replace("ray::Worker", "ray::Runtime")
    )
    cluster.until(lambda: cluster.get(path)["state"] not in {"queued", "running"}, "the end of the campaign", 1800.0)

    cells = cluster.get(path)["cells"]["requested"]
    grown = database_bytes(cluster) - size
    print(
        f"the database grew by {grown / 1e6:.0f} MB with {cells:,} cells: {grown / cells / 1e3:.2f} GB per million", flush=True
    )

    file = tmp_path / "drivecal.db"
    backup(cluster, file)
    with serving(f"sqlite:///{file}") as copy:
        assert_equal("in the cluster", found(copy, identifier), embedded)

    restore(cluster)
    assert cluster.get(path) == read(file, path)
    checked = cluster.compose("exec", "-T", "api", "drivecal", "db", "check", "--full")
    assert "is current and whole" in checked
    evaluate(cluster)


def database_bytes(cluster: Cluster) -> int:
    """What the database takes on the disk, its write-ahead log not counted."""
    query = "SELECT pg_database_size('drivecal')"
    return int(cluster.compose("exec", "-T", "db", "psql", "-U", "drivecal", "-Atc", query))


def restore(cluster: Cluster) -> None:
    """As deploy/README.md says."""
    cluster.compose("stop", "api", "dispatcher")
    cluster.compose("exec", "-T", "db", "dropdb", "-U", "drivecal", "drivecal")
    cluster.compose("exec", "-T", "db", "createdb", "-U", "drivecal", "drivecal")
    cluster.compose("run", "--rm", "-T", "migrate", "drivecal", "db", "restore", "/backups/drivecal.db")
    cluster.up("--scale", "ray-worker=6")


def read(file: Path, path: str) -> Any:
    """What a server on a backup answers."""
    with serving(f"sqlite:///{file}") as copy:
        running: RunningApi = copy
        return running.http.get(path).raise_for_status().json()


def evaluate(cluster: Cluster) -> None:
    """One cell goes all the way."""
    document = {"parameters": {f"P{i}": 0.3 for i in range(1, 12)}, "scenario": "S3"}
    identifier = cluster.http.post("/api/v1/evaluations", json=document).raise_for_status().json()["id"]
    cluster.until(lambda: cluster.get(f"/api/v1/evaluations/{identifier}")["state"] == "succeeded", "a single evaluation")


def test_nodes_of_another_machine_join_by_address_and_token_and_may_go(cluster: Cluster) -> None:
    before = cluster.ready_nodes()
    cluster.elsewhere("up", "-d", "--wait")
    (container,) = cluster.elsewhere("ps", "-q").split()
    took = cluster.until(lambda: container[:12] in cluster.ready_nodes(), "a node from elsewhere")
    print(f"a node from elsewhere was at work after {took:.0f} s", flush=True)
    cluster.elsewhere("down", "--timeout", "10")
    cluster.until(lambda: container[:12] not in {one["node"] for one in cluster.workers()}, "its end", NOTICED_SECONDS)
    assert before <= cluster.ready_nodes()


def test_a_node_with_another_token_or_too_little_shared_memory_says_so(cluster: Cluster, tmp_path: Path) -> None:
    token = tmp_path / "ray_token"
    token.write_text("0123456789abcdef0123456789abcdef")
    token.chmod(0o644)

    def attempt(*options: str) -> str:
        words = ["docker", "run", "--rm", "--network", f"{PROJECT_NAME}_cluster", "-e", "RAY_AUTH_MODE=token"]
        words += ["-e", "RAY_AUTH_TOKEN_PATH=/run/ray_token", "-v", f"{token}:/run/ray_token:ro"]
        return cluster.run(*words, *options, "drivecal/ray-worker:test", check=False)

    assert "does not accept the token in /run/ray_token; deploy/secrets.sh makes it" in attempt("--shm-size=128m")
    assert "there are 64 MB of shared memory in /dev/shm, and Ray needs 80" in attempt("--shm-size=64m")


def test_what_the_images_weigh(cluster: Cluster) -> None:
    """For the table in deploy/README.md."""
    base = cluster.run("docker", "image", "inspect", "-f", "{{.Size}}", "python:3.11-slim-bookworm").strip()
    for role in ("api", "dispatcher", "ray-head", "ray-worker"):
        size = int(cluster.run("docker", "image", "inspect", "-f", "{{.Size}}", f"drivecal/{role}:test"))
        assert size > int(base)
        print(f"{role:<12} {(size - int(base)) / 1e6:6.0f} MB above the base image", flush=True)
    time.sleep(1)
    stats = cluster.run("docker", "stats", "--no-stream", "--format", "{{.Name}} {{.MemUsage}}", *all_containers(cluster))
    print(stats, flush=True)


def all_containers(cluster: Cluster) -> list[str]:
    return [one for service in ("db", "api", "dispatcher", "ray-head", "ray-worker") for one in cluster.containers(service)]

"""The cluster as a user runs it: built, used, broken, scaled and restored on a real Docker engine. `make test-compose`."""

import time
from pathlib import Path
from typing import Any

import pytest
from tests.support.cluster_campaign import Running
from tests.support.compose import Cluster
from tests.support.faults.findings import Found
from tests.support.server import RunningApi, serving

pytestmark = [pytest.mark.compose, pytest.mark.timeout(3600)]

NOTICED_SECONDS = 10.0
KILL = """
import os, pathlib, signal
for process in pathlib.Path("/proc").glob("[0-9]*"):
    if (process / "cmdline").read_bytes().startswith(b"ray::RayWorker"):
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
    assert {worker["node"] for worker in cluster.workers()} == {
        container[:12] for container in cluster.containers("ray-worker")
    }


def test_a_campaign_survives_what_is_done_to_the_cluster(cluster: Cluster, embedded: Found, tmp_path: Path) -> None:
    size = database_bytes(cluster)
    campaign = Running(cluster)
    campaign.gets_on()
    victim, other, *_ = cluster.containers("ray-worker")
    cluster.run("docker", "exec", victim, "python", "-c", KILL)
    campaign.gets_on()
    cluster.run("docker", "kill", other)
    took = cluster.until(lambda: other[:12] not in {worker["node"] for worker in cluster.workers()}, "a lost node's notice")
    print(f"a lost node was noticed within {took:.1f} s", flush=True)
    assert took < NOTICED_SECONDS
    campaign.gets_on()
    cluster.compose("up", "-d", "--no-recreate", "--scale", "ray-worker=6")  # they start while other things happen
    scaled = time.monotonic()
    cluster.compose("restart", "--timeout", "10", "dispatcher")
    campaign.gets_on()
    cluster.compose("restart", "--timeout", "10", "db")
    campaign.gets_on(0)
    cluster.until(lambda: len(cluster.ready_nodes()) == 6, "six nodes at work")
    print(f"six nodes were at work {time.monotonic() - scaled:.0f} s after they were asked for", flush=True)
    campaign.gets_on(0)
    cluster.run(
        "docker", "exec", cluster.containers("ray-worker")[-1], "python", "-c", KILL.replace("ray::RayWorker", "ray::Runtime")
    )
    campaign.wait()

    cells = cluster.get(campaign.path)["cells"]["requested"]
    grown = database_bytes(cluster) - size
    print(f"the database grew {grown / 1e6:.0f} MB with {cells:,} cells: {grown / cells / 1e3:.2f} GB per million", flush=True)

    file = tmp_path / "drivecal.db"
    campaign.assert_found(embedded, file)
    restore(cluster, file)
    assert cluster.get(campaign.path) == read(file, campaign.path)
    checked = cluster.compose("exec", "-T", "api", "drivecal", "db", "check")
    assert "is current and whole" in checked
    evaluate(cluster)


def database_bytes(cluster: Cluster) -> int:
    """Returns what the database takes on the disk, its write-ahead log not counted."""
    query = "SELECT pg_database_size('drivecal')"
    return int(cluster.compose("exec", "-T", "db", "psql", "-U", "drivecal", "-Atc", query))


def restore(cluster: Cluster, file: Path) -> None:
    """As docs/pages/how-to/backup.md says, of a backup that was kept elsewhere."""
    cluster.compose("exec", "-T", "api", "tee", "/backups/elsewhere.db", given=file.read_bytes())
    cluster.compose("stop", "api", "dispatcher")
    cluster.compose("exec", "-T", "db", "dropdb", "-U", "drivecal", "drivecal")
    cluster.compose("exec", "-T", "db", "createdb", "-U", "drivecal", "drivecal")
    assert "`drivecal db upgrade`" in cluster.compose("run", "--rm", "--no-deps", "-T", "dispatcher", check=False)
    cluster.compose("up", "-d", "--no-deps", "api")  # the API stays, and can be asked what is wrong
    cluster.until(lambda: "is empty; run `drivecal db upgrade`" in cluster.problems(), "that the database is not migrated")
    cluster.compose("stop", "api")
    cluster.compose("run", "--rm", "-T", "migrate", "drivecal", "db", "restore", "/backups/elsewhere.db")
    cluster.up("--scale", "ray-worker=6")


def read(file: Path, path: str) -> Any:
    """Returns what a server on a backup answers."""
    with serving(f"sqlite:///{file}") as copy:
        running: RunningApi = copy
        return running.http.get(path).raise_for_status().json()


def evaluate(cluster: Cluster) -> None:
    """One cell goes all the way."""
    document = {"parameters": {f"P{i}": 0.3 for i in range(1, 12)}, "scenario": "S3"}
    identifier = cluster.http.post("/api/v1/evaluations", json=document).raise_for_status().json()["id"]
    cluster.until(lambda: cluster.get(f"/api/v1/evaluations/{identifier}")["state"] == "succeeded", "a single evaluation")


def test_what_the_images_weigh(cluster: Cluster) -> None:
    """For the table in docs/pages/reference/cluster.md."""
    base = cluster.run("docker", "image", "inspect", "-f", "{{.Size}}", "python:3.11-slim-bookworm").strip()
    for role in ("api", "dispatcher", "ray-head", "ray-worker"):
        size = int(cluster.run("docker", "image", "inspect", "-f", "{{.Size}}", f"drivecal/{role}:test"))
        assert size > int(base)
        print(f"{role:<12} {(size - int(base)) / 1e6:6.0f} MB above the base image", flush=True)
    time.sleep(1)
    stats = cluster.run("docker", "stats", "--no-stream", "--format", "{{.Name}} {{.MemUsage}}", *all_containers(cluster))
    print(stats, flush=True)


def all_containers(cluster: Cluster) -> list[str]:
    return [
        container
        for service in ("db", "api", "dispatcher", "ray-head", "ray-worker")
        for container in cluster.containers(service)
    ]

"""Problems that attack whatever they reach, on the nodes of the cluster next to a campaign that works."""

import json
import time
from pathlib import Path
from typing import Any

import pytest
from tests.support.attacks import ATTACKS
from tests.support.compose import Cluster
from tests.support.hostile import (
    CAUSES,
    NEIGHBOUR,
    UNNOTICED,
    WORKING,
    WORKS,
    assert_costs,
    attack,
    attacker,
    ended,
    held_back,
    is_pending,
    push,
    push_attacker,
)

from drivecal.client import Client

pytestmark = [pytest.mark.compose, pytest.mark.timeout(3600)]

MARK = "mark-of-the-attacks"
REACH = {
    "home": "/home/drivecal",
    "cache": "/tmp/drivecal-bundles",
    "secret": "/run/secrets/ray_token",
    "mark": MARK,
    "sockets": ["/tmp/ray/session_2*/sockets/*"],
    "shared": f"/dev/shm/{MARK}",
    "elsewhere": "/nowhere",
    "server": 1,
    "url": "http://api:8000",
    "port": 4711,
    "doublings": 9,
    "memory_mb": 4000,
    "disk_mb": 3000,
}
"""Sizes of the attacks: more memory and disk than the node's container has."""
NOT_THERE = {"overwrites_the_database", "holds_up_the_database", "reads_the_secret_of_another_server"}
"""Attacks on files that no node has; the database itself is among the others that are out of reach."""
IN_CONTAINERS = {
    **CAUSES,
    "fills_the_disk_with_a_large_file": "its files take",
    "pushes_a_problem": "URLError",
    "reaches_others": "Network is unreachable",
}
LOOK = """
import json, os, pathlib, sys
commands = []
for process in pathlib.Path("/proc").glob("[0-9]*"):
    try:
        command = (process / "cmdline").read_bytes().replace(bytes(1), b" ").decode(errors="replace")
    except OSError:
        continue
    if int(process.name) != os.getpid():
        commands.append(command)
folders = ("/tmp", "/dev/shm", "/home", "/var/tmp")
files = [str(path) for folder in folders for name in ("*", "drivecal-runs-*/*") for path in pathlib.Path(folder).glob(name)]
used = {}
for folder in ("/tmp", "/dev/shm"):
    disk = os.statvfs(folder)
    used[folder] = (disk.f_blocks - disk.f_bavail) * disk.f_frsize >> 20
print(json.dumps({"commands": commands, "files": files, "used_mb": used}))
"""
"""Prints what runs on a node, what lies in its writable places, and how full these are."""


def look(cluster: Cluster, node: str) -> dict[str, Any]:
    """Returns what is on a node."""
    result: dict[str, Any] = json.loads(cluster.run("docker", "exec", node, "python", "-S", "-c", LOOK))
    return result


def remains(cluster: Cluster, node: str) -> list[str]:
    """Processes of simulators and files of sessions and attacks on a node."""
    seen = look(cluster, node)
    processes = [each for each in seen["commands"] if MARK in each or "drivecal/adapters/" in each]
    files = [each for each in seen["files"] if MARK in each or "/drivecal-run-" in each]
    return processes + files


def others(cluster: Cluster) -> list[list[str | int]]:
    """Addresses that no node may reach: database and API by name and by number, and one of another network."""
    result: list[list[str | int]] = []
    for service, port in (("db", 5432), ("api", 8000)):
        result.append([service, port])
        (container,) = cluster.containers(service)
        addresses = "{{range .NetworkSettings.Networks}}{{.IPAddress}} {{end}}"
        result += [[address, port] for address in cluster.run("docker", "inspect", "-f", addresses, container).split()]
    return [*result, ["192.0.2.1", 443]]


def lives(cluster: Cluster) -> set[str]:
    """Containers of the cluster, each with the time of its start: another life has another time."""
    services = ("db", "api", "dispatcher", "ray-head", "ray-worker")
    containers = [container for service in services for container in cluster.containers(service)]
    return set(
        cluster.run("docker", "inspect", "-f", "{{.Name}} {{.State.StartedAt}} {{.RestartCount}}", *containers).splitlines()
    )


def test_an_attack_on_a_node_costs_its_cell_and_nothing_of_a_campaign_beside_it(cluster: Cluster, tmp_path: Path) -> None:
    nodes = cluster.containers("ray-worker")
    cluster.until(lambda: len(cluster.ready_nodes()) == len(nodes), "that all nodes work")
    with Client(cluster.url, cluster.token) as client:
        data = REACH | {"others": others(cluster)}
        for node in nodes:
            cluster.run("docker", "exec", node, "sh", "-c", f"echo 1 > /dev/shm/{MARK}; ls /tmp/ray/session_2*/sockets/*")
        push_attacker(client, tmp_path, attacker(data))
        push(client, tmp_path, WORKING, WORKS)
        begin = time.monotonic()
        alone = client.wait(client.submit(NEIGHBOUR).id)
        seconds_alone = time.monotonic() - begin
        assert (alone.state, alone.cells.failed) == ("succeeded", 0)
        before = {node: look(cluster, node) for node in nodes}
        workers, running = {worker.id for worker in client.workers().items}, lives(cluster)

        posted = {name: attack(client, name) for name in held_back(sorted(ATTACKS.keys() - NOT_THERE))}
        begin = time.monotonic()
        beside = client.wait(client.submit(NEIGHBOUR).id)
        print(f"the neighbour took {time.monotonic() - begin:.1f} s, alone {seconds_alone:.1f} s", flush=True)
        assert any(is_pending(client, identifier) for identifier in posted.values()), "the attacks did not outlast the campaign"
        assert (beside.state, beside.cells, beside.best) == ("succeeded", alone.cells, alone.best)

        cells = {name: ended(client, identifier) for name, identifier in posted.items()}
        print(f"{len(posted)} attacks had ended {time.monotonic() - begin:.1f} s after they were posted", flush=True)
        lost = assert_costs(cells, IN_CONTAINERS)
        assert cells.keys() - lost.keys() == UNNOTICED
        assert (cluster.secrets / "ray_token").read_text().strip() not in str(lost)
        for node in nodes:
            assert cluster.run("docker", "exec", node, "sh", "-c", f"cat /dev/shm/{MARK} && rm /dev/shm/{MARK}") == "1\n"
        assert lives(cluster) == running
        assert {worker.id for worker in client.workers().items} == workers

        cluster.compose("restart", "--timeout", "10", "dispatcher")  # new workers: all sessions of simulators end
        cluster.until(lambda: not any(remains(cluster, node) for node in nodes), "that sessions leave nothing there", 120)
        after = {node: look(cluster, node) for node in nodes}
        for node in nodes:
            print(node[:12], before[node]["used_mb"], after[node]["used_mb"], flush=True)
            assert after[node]["used_mb"]["/dev/shm"] <= before[node]["used_mb"]["/dev/shm"]
            assert after[node]["used_mb"]["/tmp"] <= before[node]["used_mb"]["/tmp"] + 64
        cluster.until(lambda: len(cluster.ready_nodes()) == len(nodes), "that all nodes work again")
        again = client.wait(client.submit(NEIGHBOUR).id)
        assert (again.state, again.cells, again.best) == ("succeeded", alone.cells, alone.best)


@pytest.mark.parametrize(("name", "doublings", "memory_mb"), [("memory_without_end", 9, 8000), ("fork_bomb", 13, 300)])
def test_a_large_attack_costs_its_cell(cluster: Cluster, tmp_path: Path, name: str, doublings: int, memory_mb: int) -> None:
    """More memory than a node has, by a manifest that asks for it, and twice the processes that its container may run."""
    nodes = cluster.containers("ray-worker")
    cluster.until(lambda: len(cluster.ready_nodes()) == len(nodes), "that all nodes work")
    with Client(cluster.url, cluster.token) as client:
        manifest = attacker(REACH | {"others": [], "doublings": doublings}, name.replace("_", "-"), memory_mb)
        push_attacker(client, tmp_path, manifest)
        workers, running = {worker.id for worker in client.workers().items}, lives(cluster)
        try:
            assert ended(client, attack(client, name, manifest["problem"])).outcome == "failed"
            assert lives(cluster) == running
            assert {worker.id for worker in client.workers().items} == workers
        finally:
            cluster.until(lambda: len(cluster.ready_nodes()) == len(nodes), "that all nodes work again")

"""Four machines, containers standing for them: one has the head, three join it by address and token; next to another cluster."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.support.cluster_campaign import Running
from tests.support.compose import FILE, PROJECT_NAME, Cluster, Machine
from tests.support.faults.findings import Found

pytestmark = [pytest.mark.compose, pytest.mark.timeout(3600)]

NOTICED_SECONDS = 10.0
NETWORK = f"{PROJECT_NAME}-machines"


@pytest.fixture
def head(cluster: Cluster, tmp_path: Path) -> Iterator[Cluster]:
    """The first of several machines (`how-to/machines.md`): database, API, dispatcher, head and a node. It shares its images
    with `cluster`, which keeps running."""
    files = (FILE, "deploy/docker-compose.machines.yml")
    settings = {"DRIVECAL_NETWORK": NETWORK, "DRIVECAL_NODES": "1"}
    running = Cluster(tmp_path, f"{PROJECT_NAME}-head", files, settings)
    cluster.run("docker", "network", "create", "--internal", NETWORK)
    try:
        running.up()
        yield running
    finally:
        running.close()
        running.run("docker", "network", "rm", NETWORK, check=False)


@pytest.fixture
def machines(head: Cluster) -> Iterator[list[Machine]]:
    """The other three; nothing of theirs runs yet."""
    result = [Machine(head, f"machine-{number}", NETWORK) for number in (2, 3, 4)]
    yield result
    for machine in result:
        machine.compose("down", "--timeout", "5", check=False)


def test_machines_join_and_leave_in_a_campaign_and_nothing_changes(
    cluster: Cluster, head: Cluster, machines: list[Machine], embedded: Found, tmp_path: Path
) -> None:
    second, third, fourth = machines
    (first,) = head.ready_nodes()
    campaign = Running(head)
    campaign.gets_on()

    def cells() -> dict[str, int]:
        """Checks that each node has simulated since it joined."""
        return {worker["node"]: worker["cells"] for worker in head.workers()}

    for machine in machines:
        machine.join()
    four = {first, *(machine.node for machine in machines)}
    took = head.until(lambda: {node for node, number in cells().items() if number} == four, "work on all machines")
    print(f"four machines were at work {took:.0f} s after the last one had started", flush=True)
    said = head.drivecal("workers")
    assert {node for node in four if node in said} == four
    campaign.gets_on()

    head.run("docker", "network", "disconnect", "--force", NETWORK, second.container)  # the cable is pulled
    took = head.until(lambda: second.node not in cells(), "a machine that fell silent")
    print(f"a machine that fell silent was noticed within {took:.1f} s", flush=True)
    assert took < NOTICED_SECONDS
    campaign.gets_on()
    third.compose("kill")
    took = head.until(lambda: third.node not in cells(), "a machine that went down")
    print(f"a machine that went down was noticed within {took:.1f} s", flush=True)
    assert took < NOTICED_SECONDS
    said = head.drivecal("workers")
    assert {node for node in four if node in said} == {first, fourth.node}
    campaign.gets_on()
    head.run("docker", "network", "connect", NETWORK, second.container)
    third.compose("start")
    head.until(lambda: set(cells()) == four, "the machines to come back")
    campaign.wait()
    campaign.assert_found(embedded, tmp_path / "drivecal.db")

    assert cluster.is_ready()
    assert not {worker["node"] for worker in cluster.workers()} & four
    assert cluster.http.get(campaign.path).status_code == 404

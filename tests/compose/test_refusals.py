"""What is wrong with a cluster is said by the service that it concerns, and by `/readyz`; nothing starts again and again without a word."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import pytest
from tests.support.compose import Cluster

from drivecal.cluster.release import release

pytestmark = [pytest.mark.compose, pytest.mark.timeout(1800)]

OTHER_TOKEN = "0123456789abcdef0123456789abcdef"
OTHER_VERSION = "0.0.9"
OTHER_RELEASE = release().replace(version("drivecal"), OTHER_VERSION)
"""The same sources under another version."""
METADATA = f"/opt/drivecal/lib/python3.11/site-packages/drivecal-{version('drivecal')}.dist-info/METADATA"
"""Where an image's drivecal says which version it is."""


@pytest.fixture(autouse=True)
def ready_before_and_after(cluster: Cluster) -> Iterator[None]:
    """Each of these begins and ends with a cluster all of whose nodes work."""

    def all_work() -> bool:
        return len(cluster.ready_nodes()) == len(cluster.containers("ray-worker"))

    cluster.until(all_work, "that all nodes work")
    yield
    cluster.until(all_work, "that all nodes work again")


@pytest.fixture
def other_token(tmp_path: Path) -> Path:
    """A file with another cluster's token."""
    file = tmp_path / "ray_token"
    file.write_text(OTHER_TOKEN)
    file.chmod(0o644)
    return file


@pytest.fixture
def other_release(cluster: Cluster, tmp_path: Path) -> str:
    """A mount that makes an image's drivecal one of another release."""
    file = tmp_path / "METADATA"
    ours = cluster.compose("exec", "-T", "api", "cat", METADATA)
    file.write_text(ours.replace(f"\nVersion: {version('drivecal')}\n", f"\nVersion: {OTHER_VERSION}\n"))
    file.chmod(0o644)
    return f"{file}:{METADATA}:ro"


def assert_said(cluster: Cluster, service: str, words: str, *, in_readyz: str | None = None) -> None:
    """In the log, and in `/readyz`."""
    cluster.until(lambda: (in_readyz or words) in cluster.problems(), f"that /readyz says: {in_readyz or words}", 120.0)
    assert words in cluster.compose("logs", "--no-log-prefix", service)


def test_a_dispatcher_with_another_token_waits_and_says_so(cluster: Cluster, other_token: Path) -> None:
    with cluster.changed("dispatcher", secrets={"ray_token": {"file": str(other_token)}}):
        assert_said(cluster, "dispatcher", "does not accept the token in /run/secrets/ray_token; deploy/secrets.sh makes it")
        (container,) = cluster.containers("dispatcher")
        assert cluster.restarts(container) == 0


def test_a_dispatcher_of_another_release_gives_no_work_and_names_both(cluster: Cluster, other_release: str) -> None:
    with cluster.changed("dispatcher", services={"dispatcher": {"volumes": [other_release]}}):
        in_readyz = f"are of another version than the coordinator ({OTHER_RELEASE}): "
        said = f"this node has drivecal {OTHER_RELEASE} and the head at ray-head:6379 has {release()}"
        assert_said(cluster, "dispatcher", said, in_readyz=in_readyz)
        assert f"has drivecal {release()}; install the same release on both" in cluster.problems()
        assert not cluster.is_ready()


def test_a_node_of_another_release_gets_no_work_and_both_are_named(cluster: Cluster, other_release: str) -> None:
    before = cluster.ready_nodes()
    words = [
        *node(cluster, cluster.secrets / "ray_token"),
        "-d",
        "-v",
        other_release,
        "--shm-size=128m",
        "drivecal/ray-worker:test",
    ]
    container = cluster.run(*words).strip()
    try:
        cluster.until(
            lambda: f"{container[:12]} has drivecal {OTHER_VERSION}" in cluster.problems(), "a version that is refused"
        )
        said = cluster.run("docker", "logs", container, check=False)
        assert f"this node has drivecal {OTHER_RELEASE} and the head at ray-head:6379 has {release()}" in said
        said = cluster.compose("logs", "--no-log-prefix", "dispatcher")
        assert f"node {container[:12]} gets no work: this coordinator has drivecal {release()}" in said
        assert cluster.ready_nodes() == before
        assert cluster.is_ready()  # the others work on
    finally:
        cluster.run("docker", "rm", "-f", container)
    cluster.until(lambda: not cluster.problems(), "that nothing is wrong any more")


def node(cluster: Cluster, token: Path) -> list[str]:
    """One more container in the cluster's network."""
    words = ["docker", "run", "--rm", "--network", f"{cluster.project}_cluster", "-e", "RAY_AUTH_MODE=token"]
    return [*words, "-e", "RAY_AUTH_TOKEN_PATH=/run/ray_token", "-v", f"{token}:/run/ray_token:ro"]


@pytest.mark.parametrize("role", ["ray-head", "ray-worker"])
def test_a_node_that_lacks_something_ends_with_a_line_that_says_what(cluster: Cluster, other_token: Path, role: str) -> None:
    def attempt(*options: str) -> str:
        return cluster.run(*node(cluster, other_token), *options, f"drivecal/{role}:test", check=False)

    assert "there are 64 MB of shared memory in /dev/shm, and Ray needs 80" in attempt("--shm-size=64m")
    if role == "ray-worker":
        assert "does not accept the token in /run/ray_token; deploy/secrets.sh makes it" in attempt("--shm-size=128m")

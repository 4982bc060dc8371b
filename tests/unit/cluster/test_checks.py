"""What a node says when it cannot be part of a cluster."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace

import pytest

from drivecal.cluster import __main__ as node
from drivecal.cluster.checks import check_shared_memory, check_token, version_gap
from drivecal.cluster.members import Node, ask, members
from drivecal.cluster.settings import OBJECT_STORE_BYTES, VERSION_LABEL
from drivecal.domain.errors import ConflictError, InvalidInputError, UnavailableError

TOKEN = "0123456789abcdef"
HEAD = Node("head", "a" * 56, 0, version("drivecal"), is_head=True)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, r"the cluster's token cannot be read from .*ray_token: No such file or directory; deploy/secrets.sh makes it"),
        (b"", "has 0 characters, 16 are the least"),
        (b"short\n", "has 5 characters, 16 are the least"),
        (b"\xff" * 20, "it is no text"),
    ],
)
def test_a_token_that_cannot_be_shown_is_named_with_its_file_and_never_quoted(
    tmp_path: Path, content: bytes | None, message: str
) -> None:
    if content is not None:
        (tmp_path / "ray_token").write_bytes(content)
    with pytest.raises(InvalidInputError, match=message) as raised:
        check_token({"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN_PATH": str(tmp_path / "ray_token")})
    assert "short" not in str(raised.value)


def test_a_node_without_any_token_does_not_start_unless_that_is_asked_for() -> None:
    with pytest.raises(InvalidInputError, match="RAY_AUTH_TOKEN_PATH: the cluster's token is missing; name its file"):
        check_token({})
    check_token({"RAY_AUTH_MODE": "disabled"})
    check_token({"RAY_AUTH_TOKEN": TOKEN})


def test_a_token_in_a_file_is_enough(tmp_path: Path) -> None:
    (tmp_path / "ray_token").write_text(TOKEN + "\n")
    check_token({"RAY_AUTH_TOKEN_PATH": str(tmp_path / "ray_token")})


def test_too_little_shared_memory_is_said_with_what_is_needed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free = 64 * 2**20
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free))
    with pytest.raises(ConflictError, match=r"64 MB of shared memory in .*, and Ray needs 80; .*shm_size: 128m"):
        check_shared_memory(tmp_path)
    free = OBJECT_STORE_BYTES
    check_shared_memory(tmp_path)


def test_another_version_than_the_heads_is_said_with_both() -> None:
    ours = version("drivecal")
    gap = version_gap("9.9", "h:1")
    assert gap is not None
    assert gap.startswith(
        f"this node has drivecal {ours} and the head at h:1 has 9.9: a coordinator of another release gives it no work"
    )
    assert version_gap(ours, "h:1") is None
    assert version_gap(None, "h:1") is None


def test_a_node_waits_for_its_head_longer_and_longer_and_then_compares_versions(caplog: pytest.LogCaptureFixture) -> None:
    answers: list[Sequence[Node] | None] = [None, None, None, None, None, None, [HEAD]]
    pauses: list[float] = []

    def nodes_of(_: str) -> Sequence[Node]:
        answer = answers.pop(0)
        if answer is None:
            raise UnavailableError("nobody answers")
        return answer

    node.wait_for_head("h:1", nodes_of, pauses.append)
    assert pauses == [1.0, 2.0, 4.0, 8.0, 10.0, 10.0]
    said = "the head at h:1 has 9.9"
    assert said not in caplog.text
    node.wait_for_head("h:1", lambda _: [Node("head", "a", 0, "9.9", is_head=True)])
    assert said in caplog.text


def test_the_head_offers_no_dashboard_and_simulates_nothing() -> None:
    command = node.head_command(6379, {})
    assert command[:3] == ["ray", "start", "--head"]
    assert {"--num-cpus=0", "--include-dashboard=false", "--block", f"--labels={VERSION_LABEL}={version('drivecal')}"} <= set(
        command
    )


def test_a_node_has_the_workers_it_was_told_to_have() -> None:
    assert node.cpus_of(None, {}) is None
    assert node.cpus_of(None, {"DRIVECAL_NODE_CPUS": "3"}) == 3
    assert node.cpus_of(2, {"DRIVECAL_NODE_CPUS": "3"}) == 2
    with pytest.raises(InvalidInputError, match="'many' is no number of workers"):
        node.cpus_of(None, {"DRIVECAL_NODE_CPUS": "many"})
    command = node.worker_command("h:1", 3, 6380, {"DRIVECAL_NODE_ADDRESS": "10.0.0.7"})
    assert {"--address=h:1", "--num-cpus=3", "--node-manager-port=6380", "--node-ip-address=10.0.0.7"} <= set(command)
    assert not [word for word in node.worker_command("h:1", None, 0, {}) if word.startswith(("--num-cpus", "--node-ip"))]


@pytest.mark.parametrize(
    ("address", "message"),
    [("127.0.0.1:9", "127.0.0.1:9 does not answer: "), ("nonsense", "is no address of a head; give HOST:PORT")],
)
def test_who_does_not_listen_is_named_at_once(address: str, message: str) -> None:
    with pytest.raises(UnavailableError, match=message):
        ask(address)


def test_only_nodes_that_live_are_members() -> None:
    def info(name: str, state: int, **labels: str) -> SimpleNamespace:
        return SimpleNamespace(
            node_manager_hostname=name, state=state, ALIVE=0, resources_total={"CPU": 2.0}, labels=labels, is_head_node=False
        )

    found = {b"b": info("b", 0), b"c": info("c", 1), b"a": info("a", 0, **{VERSION_LABEL: "1.2"})}
    client = SimpleNamespace(get_all_node_info=lambda timeout: found)  # noqa: ARG005  # as it is called
    assert members(client) == (Node("a", "61", 2, "1.2", is_head=False), Node("b", "62", 2, None, is_head=False))

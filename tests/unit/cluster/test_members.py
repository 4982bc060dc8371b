"""Checks of a node before it joins a cluster."""

import re
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import pytest
from tests.support.changes import replace_in
from tests.support.values import faults_of

from drivecal.cluster import __main__ as node
from drivecal.cluster import members as joining
from drivecal.cluster.members import Node, ask, check_shared_memory, check_token, members
from drivecal.cluster.settings import OBJECT_STORE_BYTES, VERSION_LABEL, release
from drivecal.domain.errors import ConflictError, InvalidInputError, UnavailableError

TOKEN = "0123456789abcdef"
HEAD = Node("head", "a" * 56, 0, release(), is_head=True)


@pytest.mark.parametrize(
    ("content", "named"),
    [(None, "No such file"), (b"", "0 characters.* 16"), (b"short\n", "5 characters.* 16"), (b"\xff" * 20, "text")],
)
def test_an_unusable_token_is_named_with_its_file_and_never_quoted(tmp_path: Path, content: bytes | None, named: str) -> None:
    if content is not None:
        (tmp_path / "ray_token").write_bytes(content)
    with pytest.raises(InvalidInputError, match=f"ray_token.*{named}") as refused:
        check_token({"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN_PATH": str(tmp_path / "ray_token")})
    (problem,) = refused.value.problems
    assert problem.field == "RAY_AUTH_TOKEN_PATH"
    assert "deploy/secrets.sh" in problem.remedy
    assert "short" not in str(refused.value)


def test_a_node_without_any_token_does_not_start_unless_that_is_asked_for() -> None:
    assert [problem.field for problem in faults_of(check_token, {})] == ["RAY_AUTH_TOKEN_PATH"]
    check_token({"RAY_AUTH_MODE": "disabled"})
    check_token({"RAY_AUTH_TOKEN": TOKEN})
    assert [problem.field for problem in faults_of(check_token, {"RAY_AUTH_TOKEN": TOKEN[1:]})] == ["RAY_AUTH_TOKEN"]


def test_a_token_in_a_file_is_enough(tmp_path: Path) -> None:
    (tmp_path / "ray_token").write_text(TOKEN + "\n")
    check_token({"RAY_AUTH_TOKEN_PATH": str(tmp_path / "ray_token")})


def test_too_little_shared_memory_is_said_with_what_is_needed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free = 64 * 2**20
    replace_in(monkeypatch, joining, "shutil", disk_usage=lambda _: SimpleNamespace(free=free))
    with pytest.raises(ConflictError, match=r"64 MB.* 80.*shm_size: 128m"):
        check_shared_memory(tmp_path)
    free = OBJECT_STORE_BYTES
    check_shared_memory(tmp_path)


def test_a_node_waits_for_its_head_longer_and_longer() -> None:
    answers: list[Sequence[Node] | None] = [None, None, None, None, None, None, [HEAD]]
    pauses: list[float] = []

    def nodes_of(_: str) -> Sequence[Node]:
        answer = answers.pop(0)
        if answer is None:
            raise UnavailableError("no response")
        return answer

    node.wait_for_head("h:1", nodes_of, pauses.append)
    assert pauses == [1.0, 2.0, 4.0, 8.0, 10.0, 10.0]


def test_the_head_offers_no_dashboard_and_simulates_nothing() -> None:
    command = node.head_command(6379, {})
    assert command[:3] == ["ray", "start", "--head"]
    assert {"--num-cpus=0", "--include-dashboard=false", "--block", f"--labels={VERSION_LABEL}={release()}"} <= set(command)


def test_a_node_has_as_many_workers_as_configured() -> None:
    assert node.cpus_of(None, {}) is None
    assert node.cpus_of(None, {"DRIVECAL_NODE_CPUS": "3"}) == 3
    assert node.cpus_of(2, {"DRIVECAL_NODE_CPUS": "3"}) == 2
    for given in ("many", "0", "-1"):
        with pytest.raises(InvalidInputError, match=f"'{given}'") as refused:
            node.cpus_of(None, {"DRIVECAL_NODE_CPUS": given})
        assert [problem.field for problem in refused.value.problems] == ["DRIVECAL_NODE_CPUS"]
    command = node.worker_command("h:1", 3, 6380, {"DRIVECAL_NODE_ADDRESS": "10.0.0.7"})
    assert {"--address=h:1", "--num-cpus=3", "--node-manager-port=6380", "--node-ip-address=10.0.0.7"} <= set(command)
    assert not [word for word in node.worker_command("h:1", None, 0, {}) if word.startswith(("--num-cpus", "--node-ip"))]


def test_an_unreachable_head_is_named_at_once() -> None:
    with pytest.raises(UnavailableError, match=re.escape("127.0.0.1:9")):
        ask("127.0.0.1:9")


@pytest.mark.parametrize(
    "address", ["nonsense", "ray-head:http", "10.0.0.1:", "127.0.0.1:99999", "::1", "2001:db8::1", "http://h:6379"]
)
def test_what_is_no_address_of_a_head_is_not_waited_for(address: str) -> None:
    assert [problem.field for problem in faults_of(ask, address)] == ["HOST:PORT"]


def test_only_nodes_that_live_are_members() -> None:
    def info(name: str, state: int, **labels: str) -> SimpleNamespace:
        return SimpleNamespace(
            node_manager_hostname=name, state=state, ALIVE=0, resources_total={"CPU": 2.0}, labels=labels, is_head_node=False
        )

    infos = {b"b": info("b", 0), b"c": info("c", 1), b"a": info("a", 0, **{VERSION_LABEL: "1.2"})}
    client = SimpleNamespace(get_all_node_info=lambda timeout: infos)  # noqa: ARG005  # as it is called
    assert members(client) == (Node("a", "61", 2, "1.2", is_head=False), Node("b", "62", 2, None, is_head=False))

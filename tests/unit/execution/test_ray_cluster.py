import fcntl
import os
import shutil
import stat
import time
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.changes import replace_in

from drivecal.cluster import machine
from drivecal.cluster.members import Node
from drivecal.execution.ray import cluster
from drivecal.execution.ray.backend import complaint, missing
from drivecal.execution.ray.cluster import LONGEST_FOLDER, private_folder


@pytest.fixture
def parent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(cluster, "LONGEST_FOLDER", 1000)
    return tmp_path


def test_only_the_user_can_enter_ray_s_folder(parent: Path) -> None:
    folder, lock = private_folder()
    assert (folder.parent, stat.S_IMODE(folder.stat().st_mode)) == (parent, 0o700)
    os.close(lock)


def test_folders_of_dead_processes_are_removed(parent: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dead, living, young = (parent / f"drivecal-ray-{name}" for name in ("dead", "living", "young"))
    other = parent / "something-else"
    for folder in (dead, living, other):
        folder.mkdir()
    lock = os.open(living, os.O_RDONLY)
    fcntl.flock(lock, fcntl.LOCK_EX)
    now = time.time()
    replace_in(monkeypatch, machine, "time", time=lambda: now + 3600.0)
    created, own = private_folder()
    assert sorted(parent.iterdir()) == sorted([created, living, other])
    os.close(lock)
    os.close(own)
    monkeypatch.undo()
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(parent))
    monkeypatch.setattr(cluster, "LONGEST_FOLDER", 1000)
    young.mkdir()
    os.close(private_folder()[1])
    assert young.exists()


def test_ray_s_sockets_fit_into_a_unix_socket_s_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    deep = tmp_path / ("x" * 80)
    deep.mkdir()
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(deep))
    folder, lock = private_folder()
    assert len(str(folder / "r")) <= LONGEST_FOLDER
    shutil.rmtree(folder)
    os.close(lock)


OURS = "1.0"


def node(identifier: str, cpus: int, version: str | None = OURS) -> Node:
    return Node(f"node-{identifier}", identifier, cpus, version, is_head=False)


clusters = st.lists(
    st.builds(node, st.uuids().map(str), st.integers(0, 5), st.sampled_from([OURS, None, "0.9"])),
    max_size=6,
    unique_by=lambda one: one.id,
)


@given(clusters, st.none() | st.integers(0, 20))
def test_workers_fill_the_nodes_of_this_version_and_no_more(nodes: list[Node], most: int | None) -> None:
    result = missing(nodes, [], most, OURS)
    room = {item.id: item.cpus for item in nodes if item.version in {OURS, None}}
    count = Counter(entry.id for entry in result)
    assert all(number <= room.get(identifier, 0) for identifier, number in count.items())
    assert len(result) == min(sum(room.values()), sum(room.values()) if most is None else most)
    assert missing(nodes, [element.id for element in result], most, OURS) == []


def test_few_workers_are_spread_over_many_nodes() -> None:
    nodes = [node("a", 4), node("b", 4), node("c", 1)]
    assert [item.id for item in missing(nodes, [], 4, OURS)] == ["a", "b", "c", "a"]
    assert [entry.id for entry in missing(nodes, ["a", "a"], 4, OURS)] == ["b", "c"]


def test_workers_of_nodes_that_are_gone_count_no_more() -> None:
    assert [item.id for item in missing([node("a", 1)], ["gone", "gone"], 2, OURS)] == ["a"]


def test_what_is_wrong_with_the_nodes_is_said() -> None:
    head = node("head", 0)
    assert complaint([head, node("a", 1)], OURS, "the cluster") is None
    assert (
        complaint([head], OURS, "the cluster") == "the cluster has no node with workers; start some, and they get work at once"
    )
    assert complaint([head, node("a", 1), node("b", 1, "0.9")], OURS, "the cluster") == (
        "1 of 2 nodes get no work, for they are of another version than the coordinator (1.0): node-b has drivecal 0.9;"
        " install the same release on both"
    )

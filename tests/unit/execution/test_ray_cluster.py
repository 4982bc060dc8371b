import fcntl
import os
import stat
import time
from pathlib import Path

import pytest
from tests.support.changes import replace_in

from drivecal.execution.ray import cluster
from drivecal.execution.ray.cluster import LONGEST_FOLDER, _PrivateFolder


@pytest.fixture
def parent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(cluster, "LONGEST_FOLDER", 1000)
    return tmp_path


def test_only_the_user_can_enter_ray_s_folder_and_it_goes_with_its_process(parent: Path) -> None:
    folder = _PrivateFolder()
    assert stat.S_IMODE(folder.path.parent.stat().st_mode) == 0o700
    folder.path.mkdir()
    (folder.path / "log").write_text("some words")
    folder.remove()
    assert list(parent.iterdir()) == []


def test_folders_of_dead_processes_are_removed_those_of_living_ones_are_not(
    parent: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dead, living, young = (parent / f"drivecal-ray-{name}" for name in ("dead", "living", "young"))
    other = parent / "something-else"
    for folder in (dead, living, other):
        folder.mkdir()
    lock = os.open(living, os.O_RDONLY)
    fcntl.flock(lock, fcntl.LOCK_EX)
    now = time.time()
    replace_in(monkeypatch, cluster, "time", time=lambda: now + 3600.0)
    _PrivateFolder().remove()
    assert sorted(parent.iterdir()) == [living, other]
    os.close(lock)
    monkeypatch.undo()
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(parent))
    monkeypatch.setattr(cluster, "LONGEST_FOLDER", 1000)
    young.mkdir()
    _PrivateFolder().remove()
    assert young.exists()


def test_ray_s_sockets_fit_into_a_unix_socket_s_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    deep = tmp_path / ("x" * 80)
    deep.mkdir()
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(deep))
    folder = _PrivateFolder()
    assert len(str(folder.path)) <= LONGEST_FOLDER
    folder.remove()

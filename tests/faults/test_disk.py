"""The disk under the database is full for a while, or cannot be written to when the server starts."""

import errno
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from tests.support.faults.coordinator import READY_SECONDS, Coordinator, coordinator
from tests.support.faults.findings import Found
from tests.support.faults.lives import Moment, and_ready_again, live

FULL_SECONDS = 20.0


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 64 MB in memory; only root may mount one."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = shutil.which("mount")
    if os.geteuid() != 0 or mount is None:
        pytest.skip("only root can mount a small disk")
    done = subprocess.run(
        [mount, "-t", "tmpfs", "-o", "size=64m", "tmpfs", str(folder)], capture_output=True, text=True, check=False
    )
    if done.returncode:
        pytest.skip(f"a small disk cannot be mounted here: {done.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


@pytest.fixture
def server(disk: Path, tmp_path: Path) -> Iterator[Coordinator]:
    """A server whose database lies on it."""
    with coordinator(tmp_path / "server", f"sqlite:///{disk / 'drivecal.db'}") as running:
        yield running


def _fill(folder: Path) -> Path:
    """Takes the last byte."""
    file = folder / "fills-the-disk"
    with file.open("wb", buffering=0) as filler:
        for size in (2**20, 2**12, 1):
            while True:
                try:
                    filler.write(b"\0" * size)
                except OSError as error:
                    if error.errno != errno.ENOSPC:
                        raise
                    break
    return file


@pytest.mark.faults
@pytest.mark.timeout(3600)
def test_a_full_disk_only_delays_campaigns(disk: Path, server: Coordinator, without_faults: dict[str, Found]) -> None:
    def disk_full(coordinator: Coordinator) -> None:
        file = _fill(disk)
        time.sleep(FULL_SECONDS)
        state = coordinator.answers("/readyz")
        assert state is not None, "the API did not live through it"
        assert state.status_code == httpx.codes.SERVICE_UNAVAILABLE
        print(f"         {state.json()['problems']}", flush=True)
        file.unlink()

    live(server, [(Moment(at, 0.0), and_ready_again(disk_full)) for at in (0.2, 0.6)], without_faults)


@pytest.mark.faults
@pytest.mark.timeout(3600)
def test_a_read_only_disk_is_refused_at_the_start(disk: Path, server: Coordinator, without_faults: dict[str, Found]) -> None:
    def read_only(coordinator: Coordinator) -> None:
        coordinator.terminate()
        coordinator.close_database()
        _remount(disk, "ro")
        coordinator.start()
        coordinator.until(lambda: not coordinator.running, "the end of a server that cannot write", READY_SECONDS)
        assert "Read-only file system" in coordinator.told()
        coordinator.wait_gone()
        _remount(disk, "rw")
        coordinator.start()

    live(server, [(Moment(0.4, 0.0), read_only)], without_faults)


def _remount(folder: Path, mode: str) -> None:
    subprocess.run(["mount", "-o", f"remount,{mode}", str(folder)], check=True)

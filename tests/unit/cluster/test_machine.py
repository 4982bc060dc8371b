"""CPUs and memory within the limits of a container."""

import os
from pathlib import Path

import pytest

from drivecal.cluster import machine


@pytest.fixture(autouse=True)
def groups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine with 64 CPUs and 256 GB, whose control groups are in this folder."""
    sizes = {"SC_PHYS_PAGES": 2**26, "SC_PAGE_SIZE": 4096}
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(64)))
    monkeypatch.setattr(os, "sysconf", sizes.__getitem__)
    monkeypatch.setattr(machine, "CONTROL_GROUPS", tmp_path / "groups")
    monkeypatch.setattr(machine, "OWN_GROUPS", tmp_path / "own")
    return tmp_path / "groups"


def write(folder: Path, **files: str) -> None:
    folder.mkdir(parents=True)
    for name, content in files.items():
        (folder / name.replace("_", ".", 1)).write_text(content + "\n")


def limits() -> tuple[int, int]:
    return machine.cpus(), machine.memory_bytes() // 2**30


def test_a_machine_without_control_groups_has_no_limits() -> None:
    assert limits() == (64, 256)


@pytest.mark.parametrize(
    ("quota", "memory", "expected"),
    [
        ("max 100000", "max", (64, 256)),
        ("200000 100000", str(4 * 2**30), (2, 4)),
        ("150000 100000", "max", (2, 256)),
        ("1000 100000", str(2**60), (1, 256)),
        ("9900000 100000", "max", (64, 256)),
    ],
)
def test_a_container_has_its_quota_and_its_memory(groups: Path, quota: str, memory: str, expected: tuple[int, int]) -> None:
    machine.OWN_GROUPS.write_text("0::/\n")
    write(groups, cpu_max=quota, memory_max=memory)
    assert limits() == expected


def test_the_smallest_limit_of_the_groups_around_a_process_holds(groups: Path) -> None:
    machine.OWN_GROUPS.write_text("0::/user.slice/run.scope\n")
    write(groups / "user.slice" / "run.scope", cpu_max="max 100000", memory_max=str(8 * 2**30))
    (groups / "user.slice" / "cpu.max").write_text("300000 100000\n")
    (groups / "user.slice" / "memory.max").write_text(f"{16 * 2**30}\n")
    assert limits() == (3, 8)


@pytest.mark.parametrize(("quota", "expected"), [("-1", (64, 4)), ("250000", (3, 4))])
def test_the_first_version_of_control_groups_is_known(groups: Path, quota: str, expected: tuple[int, int]) -> None:
    machine.OWN_GROUPS.write_text("5:memory:/docker/1\n4:cpu,cpuacct:/docker/1\n")
    write(groups / "cpu", cpu_cfs_quota_us=quota, cpu_cfs_period_us="100000")
    write(groups / "memory", memory_limit_in_bytes=str(4 * 2**30))
    assert limits() == expected

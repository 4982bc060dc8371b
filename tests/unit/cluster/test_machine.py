"""CPUs within the limits of a container."""

from pathlib import Path

import pytest
from tests.support.changes import replace_in

from drivecal.cluster import machine


@pytest.fixture(autouse=True)
def groups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine with 64 CPUs, whose control groups are in this folder."""
    replace_in(monkeypatch, machine, "os", sched_getaffinity=lambda _: set(range(64)))
    monkeypatch.setattr(machine, "CONTROL_GROUPS", tmp_path / "groups")
    monkeypatch.setattr(machine, "OWN_GROUPS", tmp_path / "own")
    return tmp_path / "groups"


def write(folder: Path, **files: str) -> None:
    folder.mkdir(parents=True)
    for name, content in files.items():
        (folder / name.replace("_", ".", 1)).write_text(content + "\n")


def test_a_machine_without_control_groups_has_no_limits() -> None:
    assert machine.cpus() == 64


@pytest.mark.parametrize(
    ("quota", "expected"),
    [("max 100000", 64), ("200000 100000", 2), ("150000 100000", 2), ("1000 100000", 1), ("9900000 100000", 64)],
)
def test_a_container_has_its_quota(groups: Path, quota: str, expected: int) -> None:
    machine.OWN_GROUPS.write_text("0::/\n")
    write(groups, cpu_max=quota)
    assert machine.cpus() == expected


def test_the_smallest_limit_of_the_groups_around_a_process_holds(groups: Path) -> None:
    machine.OWN_GROUPS.write_text("0::/user.slice/run.scope\n")
    write(groups / "user.slice" / "run.scope", cpu_max="max 100000")
    (groups / "user.slice" / "cpu.max").write_text("300000 100000\n")
    assert machine.cpus() == 3


@pytest.mark.parametrize(("quota", "expected"), [("-1", 64), ("250000", 3)])
def test_the_first_version_of_control_groups_is_known(groups: Path, quota: str, expected: int) -> None:
    machine.OWN_GROUPS.write_text("5:memory:/docker/1\n4:cpu,cpuacct:/docker/1\n")
    write(groups / "cpu", cpu_cfs_quota_us=quota, cpu_cfs_period_us="100000")
    assert machine.cpus() == expected

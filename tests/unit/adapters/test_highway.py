"""Simulators of kind `highway`: how long a child serves, and what a machine or a bundle lacks, without starting one."""

import tempfile
from pathlib import Path
from typing import Any

import pytest

from drivecal.adapters import kinds
from drivecal.domain.errors import UnavailableError
from drivecal.plugins.simulators import Declared, UnsuitableError

CONTROLLER = {"kind": "fmu", "file": "acc.fmu", "signals": {"acceleration": "y"}, "output": ["acceleration"]}
FILES = {"acc.fmu", "acc.py", "road.net.xml", "day.rou.xml"}


def open_session(folder: Path, controller: dict[str, Any], *, without: str = "") -> None:
    """Opens a session of a bundle that has all files but one."""
    for name in FILES - {without}:
        (folder / name).touch()
    section = {"kind": "highway", "controller": controller, "vehicle": "single_track", "timeout": 1.0, "memory_mb": 100}
    data = {"network": "road.net.xml", "routes": "day.rou.xml"}
    kinds.simulator_of(section).open(section, "S", data, folder, Declared("trial", ("energy_kwh",)))


@pytest.mark.parametrize(
    ("controller", "most_runs"),
    [
        (CONTROLLER, kinds.MOST_FMU_RUNS),
        (CONTROLLER | {"reset": True}, kinds.MOST_FMU_RUNS),
        (CONTROLLER | {"reset": False}, 1),
        ({"kind": "python", "file": "acc.py"}, kinds.MOST_HIGHWAY_RUNS),
    ],
)
def test_a_controller_that_is_not_reset_has_a_child_for_each_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, controller: dict[str, Any], most_runs: int
) -> None:
    opened: list[dict[str, Any]] = []
    monkeypatch.setattr(kinds, "ProcessSession", lambda *_, **settings: opened.append(settings))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))  # the folder of a session that does not open remains
    open_session(tmp_path, controller)
    assert [settings["most_runs"] for settings in opened] == [most_runs]


@pytest.mark.parametrize(("package", "extra"), kinds.EXTRAS.items())
def test_a_missing_library_names_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str, extra: str) -> None:
    monkeypatch.setattr(kinds, "find_spec", lambda name: None if name == package else name)
    with pytest.raises(UnavailableError) as error:
        open_session(tmp_path, CONTROLLER)
    assert type(error.value) is UnavailableError  # another machine may have it
    assert package in str(error.value)
    assert f"drivecal[{extra}]" in str(error.value)


@pytest.mark.parametrize("missing", sorted(FILES - {"acc.py"}))
def test_a_bundle_without_a_file_suits_no_machine(tmp_path: Path, missing: str) -> None:
    with pytest.raises(UnsuitableError, match=missing):
        open_session(tmp_path, CONTROLLER, without=missing)

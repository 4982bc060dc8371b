"""Simulators of kind `highway`: how long a child serves, without starting one."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import pytest

from drivecal.adapters import highway
from drivecal.plugins.simulators import Declared

CONTROLLER = {"kind": "fmu", "file": "acc.fmu", "signals": {"acceleration": "y"}, "output": ["acceleration"]}
VEHICLE = {"kind": "fmu", "file": "car.fmu", "signals": {}}


@pytest.mark.parametrize(
    ("controller", "vehicle", "most_runs"),
    [
        (CONTROLLER, "single_track", highway.MOST_FMU_RUNS),
        (CONTROLLER | {"reset": True}, VEHICLE | {"reset": True}, highway.MOST_FMU_RUNS),
        (CONTROLLER | {"reset": False}, "single_track", 1),
        (CONTROLLER, VEHICLE | {"reset": False}, 1),
        ({"kind": "python", "file": "acc.py"}, "single_track", highway.MOST_RUNS),
        ({"kind": "python", "file": "acc.py"}, VEHICLE | {"reset": False}, 1),
    ],
)
def test_a_part_that_is_not_reset_has_a_child_for_each_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, controller: dict[str, Any], vehicle: Any, most_runs: int
) -> None:
    opened: list[dict[str, Any]] = []
    monkeypatch.setattr(highway, "ProcessSession", lambda *_, **settings: opened.append(settings))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))  # nobody removes the folder of a session that does not open
    for name in ("acc.fmu", "acc.py", "car.fmu", "road.net.xml"):
        (tmp_path / name).touch()
    section = {"controller": controller, "vehicle": vehicle, "timeout": 1.0, "memory_mb": 100}
    highway.HighwayAdapter().open(section, "S", {"network": "road.net.xml"}, tmp_path, Declared("trial", ("energy_kwh",)))
    assert [settings["most_runs"] for settings in opened] == [most_runs]

"""Compiled kernels of the simulator `highway`: a user's code finds all of them compiled, and can change none."""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.support.motorways import CONTROLLERS, EVERYTHING, PARAMETERS, ROUTE, compile_program, drive, driven, motorway
from tests.support.simulators import lost

import drivecal.highway.drive
import drivecal.highway.vehicle
from drivecal.adapters import confinement
from drivecal.bundles.highway import HighwaySimulator
from drivecal.domain.evaluations import Breakdown
from drivecal.plugins import simulators
from drivecal.plugins.simulators import UnsuitableError

TRAFFIC: list[dict[str, Any]] = [{"id": "leader", "s": 160, "speed": 30}, {"s": 60, "lane": 1, "speed": 33}]
FILLED: dict[str, Any] = {"routes": "filled.rou.xml", "begin": 100, "warm_up": 20, "ego": {"lane": 0, "s": 300, "speed": 30}}
"""Vehicles that the drive before the user's code does not meet: they enter 6 s after the begin of the warm-up."""
ENTERING = f"""<routes><route id="r" edges="{" ".join(ROUTE)}"/>
<flow id="f" route="r" begin="86" end="98" period="2" departSpeed="30"/></routes>"""
STEERS = """
def control(o, p):
    return -0.01 * o["lane_offset"], 0.0
"""
KEEPS = """
def control(o, p):
    return o["road_curvature"] - 0.002 * o["lane_offset"] - 0.04 * o["heading_error"]
"""
SESSIONS: dict[str, dict[str, Any]] = {
    "acceleration": CONTROLLERS["process"],
    "curvature": {"kind": "python", "file": "keeps.py", "output": ["curvature"]},
    "steering": {"kind": "python", "file": "steers.py", "output": ["steering", "acceleration"]},
}
WATCHED = """
import json, sys
from drivecal.highway import compilation
from drivecal.highway.drive import driver, rehearsal

late = []
def watch(writable, scratch):
    load = compilation.CacheFile.load
    def noticed(self, key):
        late.append(f"{self._index_name} {key[0]}")
        return load(self, key)
    compilation.CacheFile.load = noticed  # asked before anything is compiled
rehearsal.hold = watch
evaluate = driver.prepare(json.loads(sys.argv[1]))
evaluate({"parameters": json.loads(sys.argv[2])})
print(json.dumps(late))
"""
HOSTILE = """
import numba

@numba.njit(cache=True)
def twice(x):
    return 2.0 * x

twice(1.0)
changed = []
for folder in FOLDERS:
    for name in ("planted.pyc", FILE):
        try:
            open(f"{folder}/{name}", "ab").close()
            changed.append(name)
        except OSError:
            pass
if changed:
    raise RuntimeError(f"changed {changed}")

def control(observation, parameters):
    return 0.0
"""

LEAVES = """
import os
from pathlib import Path

from drivecal.highway.drive import geometry

scratch = Path.cwd().parent

def attempt():
    for folder in FOLDERS:
        try:
            open(f"{folder}/planted.pyc", "xb").close()
            return 1.0
        except OSError:
            pass
    if "kernels" in geometry.nearest._cache.cache_path:
        return 2.0
    return 0.0

# The first step of the run reports it, in words that a worker shows.
reached = attempt()
(scratch / "kernels").mkdir(exist_ok=True)
if "link" == "KIND":
    (scratch / "traffic.rou.xml").unlink()
    (scratch / "traffic.rou.xml").symlink_to(FOLDERS[0] + "/planted.pyc")

def control(observation, parameters):
    if parameters["c"] == 0.0:
        os._exit(1)
    if reached:
        raise RuntimeError(f"reached {reached}")
    return 0.0
"""
"""A controller whose first child leaves files for the second one."""


@pytest.mark.slow
@pytest.mark.faults("steering", "acceleration", "warm_up")
@pytest.mark.parametrize(
    ("kind", "scenario"),
    [(kind, drive(TRAFFIC, 5.0)) for kind in SESSIONS] + [("curvature", drive([], 5.0, **FILLED))],
    ids=[*SESSIONS, "warm_up"],
)
def test_every_kernel_is_there_before_a_users_code_is_loaded(kind: str, scenario: dict[str, Any], tmp_path: Path) -> None:
    bundle, scratch = motorway(tmp_path / "bundle"), tmp_path / "scratch"
    compile_program(bundle)
    (bundle / "keeps.py").write_text(KEEPS)
    (bundle / "steers.py").write_text(STEERS)
    (bundle / "filled.rou.xml").write_text(ENTERING)
    (scratch / "work").mkdir(parents=True)
    for path in bundle.iterdir():
        (scratch / "work" / path.name).symlink_to(path)
    section = HighwaySimulator.model_validate({"kind": "highway", "controller": SESSIONS[kind], "timeout": 60.0})
    settings = {
        "folder": str(bundle),
        "work": str(scratch / "work"),
        "scratch": str(scratch),
        "simulator": section.model_dump(mode="json"),
        "scenario": "trial",
        "data": scenario,
        "sumo": simulators.sumo(),
        "kernels": None,
        "changeable": [],
        "measures": list(EVERYTHING.measures),
        "series": [],
        "parameters": {},
    }
    command = [sys.executable, "-c", WATCHED, json.dumps(settings), json.dumps(PARAMETERS)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert ended.returncode == 0, ended.stderr
    assert json.loads(ended.stdout.splitlines()[-1]) == []


@pytest.fixture
def folders() -> Iterator[list[str]]:
    """Folders of drivecal's byte code and compiled kernels, without what a test that fails has planted in them."""
    places = [
        str(Path(str(module.__file__)).parent / "__pycache__") for module in (drivecal.highway.drive, drivecal.highway.vehicle)
    ]
    yield places
    for folder in places:
        Path(folder, "planted.pyc").unlink(missing_ok=True)


@pytest.mark.skipif(confinement.version() == 0, reason="this kernel has no Landlock")
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["link", "numba"])
def test_what_a_child_leaves_gives_no_later_one_access_to_kernels(kind: str, folders: list[str], tmp_path: Path) -> None:
    code = LEAVES.replace("FOLDERS", repr(folders)).replace("KIND", kind)
    bundle = motorway(tmp_path / "bundle", code)
    if kind == "numba":  # numba would load what the first child has left there
        (bundle / ".numba_config.yaml").write_text("cache_dir: ../kernels\n")
    with driven(bundle, drive([], 2.0)) as session:
        lost(session, PARAMETERS | {"c": 0.0}, Breakdown.CRASH)
        assert session.evaluate(PARAMETERS).measures
    assert [folder for folder in folders if Path(folder, "planted.pyc").exists()] == []


@pytest.mark.skipif(confinement.version() == 0, reason="this kernel has no Landlock")
def test_a_controller_changes_no_kernel_and_has_a_place_for_its_own(folders: list[str], tmp_path: Path) -> None:
    stored = next((path.name for path in Path(folders[1]).glob("*.nbi")), "kernel.nbi")
    hostile = HOSTILE.replace("FOLDERS", repr(folders)).replace("FILE", repr(stored))
    with driven(motorway(tmp_path / "bundle", hostile), drive([], 2.0)) as session:
        assert session.evaluate(PARAMETERS).measures


@pytest.mark.skipif(confinement.version() == 0, reason="this kernel has no Landlock")
def test_a_driver_with_threads_loads_no_controller(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    with (
        pytest.raises(UnsuitableError, match=r"simulator\.environment"),
        driven(motorway(tmp_path / "bundle"), drive([], 2.0), environment=["OPENBLAS_NUM_THREADS"]),
    ):
        pass

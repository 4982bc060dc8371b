"""OpenDRIVE and OpenSCENARIO files of public projects, as they are: driven from a bundle, and compared with a second reader.

`make test-packages`. The tests fetch the files: from the source archive of bark-simulator (MIT), the only examined package of PyPI with
roads of motorways (scenic, opendrive2lanelet, commonroad-scenario-designer, scenariogeneration, omega-prime, asam-qc-opendrive,
asam-qc-openscenarioxml, imap-box and pyxodr have neither `.xodr` nor `.xosc`); longer motorways and scenarios from esmini's repository
(MPL-2.0), which is skipped if GitHub cannot be reached. The second reader is pyxodr.
"""

import hashlib
import json
import subprocess
import sys
import tarfile
import urllib.request
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.integration.test_public_files import pip
from tests.support.roads import to_cartesian

from drivecal.configuration.problems import read_bundle
from drivecal.local.problems import CheckedScenario, run_problem, trial_set
from drivecal.roads.conversion import converted
from drivecal.roads.corridor import Corridor, corridor
from drivecal.roads.network import read_network
from drivecal.roads.opendrive import DRIVEN

pytestmark = [pytest.mark.packages, pytest.mark.timeout(900)]

ARCHIVE = "bark-simulator==1.0.4"
READER = ("pyxodr==0.1.3", "shapely==2.2.0", "rich==15.0.0", "markdown-it-py==4.3.0", "mdurl==0.1.2", "pygments==2.21.0")
"""pyxodr, and what it needs next to lxml, matplotlib and scipy."""
REPOSITORY = "https://raw.githubusercontent.com/esmini/esmini/77028d83e6d402de52f7187e5384d1b1c02b7d1f"
LONGEST = 30
"""Lines of a `problem.yaml`."""
NEAR = 0.1
"""Metres between a track and the second reader's centres of lanes."""
MANIFEST = """
problem: public-road
simulator:
  kind: highway
  controller: {{kind: python, file: keep.py, output: [acceleration]}}
  deterministic: true
parameters:
  speed: {{lower: {speed}, upper: {upper}}}
scenarios:
  drive: {scenario}
measures: {{distance_m: m, progress: "1", max_speed_excess_mps: m/s, lane_departures: "1"}}
scores:
  far: {{formula: distance_m, direction: maximise, range: [0, 2000]}}
"""
CONTROLLER = (
    "def control(observation, parameters):\n    return {'acceleration': 0.5 * (parameters['speed'] - observation['speed'])}\n"
)
BY_ANOTHER = """
from pyxodr.road_objects.network import RoadNetwork
centres = [
    (lane.type, lane.centre_line[:, :2].tolist())
    for road in RoadNetwork(sys.argv[1], resolution=0.1).get_roads()
    for section in road.lane_sections
    for lane in section.lanes
]
json.dump(centres, open(sys.argv[2], "w"))
"""


@dataclass(frozen=True)
class Public:
    """A public road: where it comes from, its digest, and the scenario that drives it."""

    source: str
    digest: str
    route: tuple[str, ...]
    lane: int
    speed: float
    duration: int
    limits: tuple[float, ...]
    """Metres per second of the route's lanes, from the file or the scenario."""
    default_limit: float | None = None

    def scenario(self) -> dict[str, Any]:
        """The scenario in a manifest."""
        ego = {"lane": self.lane, "s": 10, "speed": self.speed}
        data = {"network": "road.xodr", "route": list(self.route), "duration": self.duration, "ego": ego}
        return data if self.default_limit is None else data | {"default_limit": self.default_limit}


BARK = "bark-simulator-1.0.4/bark/runtime/tests/data"
FREE = 33.33
ROADS = {
    # an expressway's merge: curves, and a third lane that closes
    "merge-of-three": Public(
        f"{BARK}/DR_CHN_Merging_ZS_partial_v02.xodr",
        "7675a363581e4122a4f99eda0a907e3b21fece42226c7db29018359de0688561",
        ("-0#0", "-0#1", "-1"), 1, 15.0, 7, (35 * 0.44704,),
    ),
    # the begin of a motorway: a ramp next to one lane
    "merge-of-two": Public(
        f"{BARK}/DR_DEU_Merging_MT_v01_centered.xodr",
        "56beba0203b997f49d39dcd67643f2d67dbcfedad200745c46a35538fa3ffbb1",
        ("-0#0", "-0#1", "-1"), 1, 13.0, 6, (30 * 0.44704,),
    ),
    "without-limit": Public(
        f"{BARK}/city_highway_straight.xodr",
        "6f9aa3af30f0fd30ab151c079e8ee082e7c48cd80e928e77b3721b4303bb4e09",
        ("-16",), 0, 20.0, 7, (FREE,), FREE,
    ),
    # 1.6 km of a motorway with a ramp that joins by a direct junction
    "soderleden": Public(
        "resources/xodr/soderleden.xodr",
        "c95163a98aca403b2be6a28036a850ad798a42c92bb1d48c79f32ffe5dc263eb",
        ("-2#0", "-2#1", "-0#0", "-0#1", "-0#2"), 1, 22.0, 20, (FREE,), FREE,
    ),
    "e6": Public(
        "resources/xodr/e6mini.xodr",
        "e26ba487fe685d3151585c0e44f537c291fd17c69e98b8b15bafd04b569b3559",
        ("-0",), 2, 30.0, 20, (FREE,), FREE,
    ),
    # a lane opens and becomes an exit
    "exit": Public(
        "EnvironmentSimulator/Unittest/xodr/highway_exit.xodr",
        "5c436267f5ee331ff49a2db43da17fe65f7e121d02abcc9d5da22fc7d53b2e08",
        ("-0#0", "-0#1", "-0#2", "-0#3", "-1"), 1, 25.0, 12, (30.55,),
    ),
    "merge-and-split": Public(
        "EnvironmentSimulator/Unittest/xodr/highway_example_with_merge_and_split.xodr",
        "36a8d684838b218e24a0fb7e6e517d0b624f8ea55b85d0a8469241e5f381dde0",
        ("-0#0", "-0#1", "-0#2", "-0#3", "-1#0", "-1#1", "-1#2", "-1#3", "-5"), 1, 20.0, 15, (FREE,), FREE,
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def fetched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with pyxodr installed in it, and the unpacked source archive of bark-simulator."""
    folder = tmp_path_factory.mktemp("public")
    pip("install", "--target", str(folder), *READER)
    pip("download", "--no-binary", "bark-simulator", "--dest", str(folder), ARCHIVE)
    (archive,) = folder.glob("bark*.tar.gz")
    with tarfile.open(archive) as content:
        content.extractall(
            folder, [content.getmember(road.source) for road in ROADS.values() if road.source.startswith(BARK)], filter="data"
        )
    return folder


def public(fetched: Path, source: str, digest: str) -> bytes:
    """Content of a public file."""
    path = fetched / source
    if not path.exists():
        try:
            with urllib.request.urlopen(f"{REPOSITORY}/{source}", timeout=30) as answer:
                content = answer.read()
        except OSError as error:
            pytest.skip(f"{REPOSITORY} cannot be reached: {error}")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    content = path.read_bytes()
    assert hashlib.sha256(content).hexdigest() == digest
    return content


def driven(folder: Path, scenario: Mapping[str, Any], speed: float, files: Mapping[str, bytes]) -> CheckedScenario:
    """The result of a scenario, checked and driven from a folder with at most 30 lines of YAML."""
    folder.mkdir()
    line = yaml.safe_dump(dict(scenario), default_flow_style=True, width=1000).strip()
    manifest = MANIFEST.format(speed=speed, upper=speed + 0.5, scenario=line).strip()
    assert len(manifest.splitlines()) <= LONGEST
    for name, content in {"problem.yaml": manifest.encode(), "keep.py": CONTROLLER.encode(), **files}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    checked, archive = read_bundle(folder)
    (result,) = run_problem(checked, archive, trial_set(checked))
    return result


@pytest.mark.parametrize("name", ROADS)
def test_a_public_road_is_driven_as_it_is(fetched: Path, tmp_path: Path, name: str) -> None:
    road = ROADS[name]
    result = driven(tmp_path / "road", road.scenario(), road.speed, {"road.xodr": public(fetched, road.source, road.digest)})
    assert (result.error, result.failure, result.repeats) == (None, None, True)
    assert result.measures["distance_m"] == pytest.approx(road.speed * road.duration, rel=0.05)
    assert result.measures["lane_departures"] == 0
    assert result.measures["max_speed_excess_mps"] == 0
    assert result.measures["progress"] == pytest.approx(road.speed / road.limits[0], abs=0.05)


def measured(road: Public, content: bytes) -> Corridor:
    """The corridor of a public road."""
    return corridor(
        read_network(converted(content, "road.xodr").network, "road.xodr"), road.route, "road.xodr", road.default_limit
    )


@pytest.mark.parametrize("name", ROADS)
def test_another_reader_has_the_lanes_where_they_are_driven(fetched: Path, tmp_path: Path, name: str) -> None:
    road, file = ROADS[name], tmp_path / "road.xodr"
    file.write_bytes(public(fetched, road.source, road.digest))
    code = f"import json, sys; sys.path.append({str(fetched)!r})\n{BY_ANOTHER}"
    subprocess.run([sys.executable, "-c", code, str(file), str(tmp_path / "lanes.json")], check=True, capture_output=True)
    lanes = [np.array(points) for kind, points in json.loads((tmp_path / "lanes.json").read_text()) if kind in DRIVEN]
    nodes = np.vstack(lanes)
    ours = measured(road, file.read_bytes())
    assert {round(float(each), 3) for each in ours.limits[~np.isnan(ours.limits)]} == {round(each, 3) for each in road.limits}
    for number in range(len(ours.tracks)):
        for row in np.flatnonzero(~np.isnan(ours.centres[:, number]))[::10]:
            x, y, _ = to_cartesian(ours.line, ours.line[row, 0], ours.centres[row, number])
            assert float(np.hypot(*(nodes - (x, y)).T).min()) < NEAR


FILES = {
    "xodr/straight_500m.xodr": "af763016da63ab2f072e8a6d340bd0136b77c34eb9d6ea7b62db728e07430b5b",
    "xodr/e6mini.xodr": "e26ba487fe685d3151585c0e44f537c291fd17c69e98b8b15bafd04b569b3559",
    "xosc/alks_cut-in.xosc": "834fd7403f522a21154e405183ddd35b589e5ffaaac529120e4ba02feaae602c",
    "xosc/alks_decelerate.xosc": "45c93144ee8a46de56a7913581c8950368bf7007a4f3826ec6b99502ca44d30d",
    "xosc/cut-in.xosc": "64454eddc78316fbfc6a0a3f41860074bc45bc3db11cb34fd293a49526e7e8f6",
    "xosc/Catalogs/Vehicles/VehicleCatalog.xosc": "28fcbabcaabd7216a23d9a2e4affa23364f6d902aae4a81e471793334651cc3a",
}
"""SHA-256 of the files that the scenarios below name."""


@pytest.mark.parametrize(
    ("name", "road", "data", "speed"),
    [
        ("alks_cut-in", "straight_500m", {}, 16.0),
        ("alks_decelerate", "straight_500m", {}, 16.0),
        ("cut-in", "e6mini", {"duration": 10}, 30.0),
    ],
)
def test_a_public_scenario_is_driven_as_it_is(
    fetched: Path, tmp_path: Path, name: str, road: str, data: Mapping[str, Any], speed: float
) -> None:
    """The vehicles come from the catalog next to the scenarios. The controller does not brake: a collision is a result, too."""
    names = (f"xosc/{name}.xosc", f"xodr/{road}.xodr", "xosc/Catalogs/Vehicles/VehicleCatalog.xosc")
    files = {file: public(fetched, f"resources/{file}", FILES[file]) for file in names}
    scenario = {"openscenario": names[0], "default_limit": FREE, **data}
    result = driven(tmp_path / "scenario", scenario, speed, files)
    assert (result.error, result.repeats) == (None, True)
    assert result.failure in {None, "collision"}
    assert result.measures["distance_m"] > 50.0

"""Problems of kind `highway` as campaigns on two workers without Ray: an ACC as an FMU, and a lane keeper in C++."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from tests.support.lane_keeper import LANE_KEEPER, write_lane_keeper
from tests.support.motorways import CONTROLLERS, compile_fmu, drive, driven, motorway
from tests.support.serve import serving

from drivecal.bundles.highway_catalogue import MEASURES
from drivecal.client import Client
from drivecal.configuration.problems import read_bundle

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
SPEC: dict[str, Any] = {
    "sensitivity": None,
    "optimizer": {"kind": "genetic", "population": 4, "iterations": 1, "seed": 3},
    "reduction": {"mode": "off"},
}
BRAKING = {"id": "leader", "s": 560, "speed": 30, "actions": [{"do": "brake", "time": 4, "speed": 12, "rate": 3}]}
RANDOM = [{"s": 620, "speed": 28, "lane": lane, "model": "Krauss", "sigma": 0.4, "lane_change": "SL2015"} for lane in (0, 1)]
PROBLEMS: dict[str, tuple[Mapping[str, Any], dict[str, Any]]] = {
    "acc-as-fmu": (
        CONTROLLERS["fmu"],
        {
            "v0": {"lower": 28, "upper": 34},
            "T": {"lower": 1, "upper": 2},
            "k": {"lower": 0.05, "upper": 0.1},
            "c": {"lower": 0.5, "upper": 0.7},
        },
    ),
    "keeper-in-cpp": (LANE_KEEPER, {"gain": {"lower": 0.3, "upper": 0.7}}),
}
"""Controller and parameters."""


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    """A client of a server with two workers."""
    folder = tmp_path_factory.mktemp("server")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DRIVECAL_HOME", str(folder / "home"))
        cache = str(folder / "cache")
        with (
            serving(folder, workers=2, DRIVECAL_BACKEND="processes", DRIVECAL_BUNDLE_CACHE=cache) as server,
            Client(server.url) as client,
        ):
            yield client


@pytest.mark.parametrize("name", PROBLEMS)
def test_a_controller_gives_the_same_bits_in_any_worker(name: str, client: Client, tmp_path: Path) -> None:
    folder = made(name, tmp_path)
    manifest, _ = read_bundle(folder)
    client.push_problem(folder)
    ended = client.wait(client.submit({"problem": name} | SPEC).id)
    rows = client.evaluations(ended.id, measures="true").to_arrow().to_pylist()
    assert (ended.state, ended.error, ended.cells.failed) == ("succeeded", None, 0)
    assert {row["outcome"] for row in rows} == {"simulated"}
    assert {row["scenario"] for row in rows} == set(manifest.scenarios)
    assert len({row["worker"] for row in rows}) == 2
    controller = manifest.simulator.model_dump(mode="json")["controller"]
    for scenario in manifest.scenarios:
        with driven(folder, manifest.scenarios[scenario], controller) as session:
            for row in [row for row in rows if row["scenario"] == scenario][::-1]:  # another process, another order
                again = session.evaluate({name: float(row[name]) for name in manifest.parameters})
                assert again.measures == {name: row[f"measure_{name}"] for name in MEASURES}


def made(name: str, folder: Path) -> Path:
    """A problem on a curve, with a leader that brakes, and with random traffic."""
    controller, parameters = PROBLEMS[name]
    path = motorway(folder / name)
    compile_fmu(path)
    write_lane_keeper(path)
    manifest = {
        "problem": name,
        "parameters": parameters,
        "simulator": {"kind": "highway", "controller": dict(controller), "timeout": 60, "deterministic": True},
        "scenarios": {"braking": drive([BRAKING], 10.0, ego={"s": 500}), "random": drive(RANDOM, 10.0, ego={"s": 500}, seed=5)},
        "measures": {"rms_lane_offset_m": "m", "min_gap_m": "m"},
        "scores": {"gap": {"formula": "min_gap_m - rms_lane_offset_m", "direction": "maximise", "range": [0, 1000]}},
    }
    (path / "problem.yaml").write_text(json.dumps(manifest))
    return path

"""A problem of kind `highway` over the REST API: an analysis with its map, references by it, a validation, and the trace of a cell."""

import json
import time
from collections.abc import Iterator
from typing import Any

import pytest
from tests.support.motorways import PYTHON, motorway
from tests.support.networks import entrance
from tests.support.serve import serving
from tests.support.values import present

from drivecal.client import Client
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.evaluation import SeriesAnswer

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
ROUTE = ["before", "beside", "after"]
SCENARIO: dict[str, Any] = {"network": "merge.net.xml", "route": ROUTE, "duration": 5.0, "ego": {"s": 250, "speed": 26}}
LEADER = {"id": "leader", "s": 300, "speed": 22}
MANIFEST: dict[str, Any] = {
    "problem": "merging",
    "parameters": {
        "v0": {"lower": 24, "upper": 34},
        "T": {"lower": 1, "upper": 2},
        "k": {"lower": 0.05, "upper": 0.1},
        "c": {"lower": 0.5, "upper": 0.7},
        "unused": {"lower": 0, "upper": 1},
    },
    "simulator": {
        "kind": "highway",
        "controller": {"kind": "python", "file": "acc.py", "output": ["acceleration"]},
        "deterministic": True,
    },
    "scenarios": {"free": SCENARIO, "behind": SCENARIO | {"traffic": [LEADER]}},
    "measures": {"distance_m": "m"},
    "scores": {"far": {"formula": "distance_m", "direction": "maximise", "range": [0, 200]}},
}
SPEC: dict[str, Any] = {
    "problem": "merging",
    "sensitivity": {"intervals": 2, "samples": 2},
    "optimizer": {"kind": "genetic", "population": 6, "iterations": 2, "seed": 3},
    "validation": {"samples": 4, "references": 2, "largest": 8},
    "reduction": {"mode": "influence", "audit": 0, "max_error": 1},
}


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    """The client of a server with two workers."""
    home = tmp_path_factory.mktemp("home")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DRIVECAL_HOME", str(home / "home"))
        with (
            serving(home, workers=2, DRIVECAL_BACKEND="processes", DRIVECAL_BUNDLE_CACHE=str(home / "cache")) as server,
            Client(server.url) as connected,
        ):
            yield connected


@pytest.fixture(scope="module")
def studied(client: Client, tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """A campaign with all that a problem of a user can have."""
    folder = motorway(tmp_path_factory.mktemp("problem") / "merging", PYTHON)
    (folder / "merge.net.xml").write_bytes(entrance())
    (folder / "problem.yaml").write_text(json.dumps(MANIFEST))
    client.push_problem(folder)
    ended = client.wait(client.submit(SPEC).id, progress=False)
    assert (ended.state, ended.error, ended.cells.failed) == ("succeeded", None, 0)
    return ended


def test_the_map_of_an_analysis_says_which_parameter_matters_where(client: Client, studied: Campaign) -> None:
    rows = {(row.scenario, row.parameter): row.influential for row in client.influence(studied.id)}
    assert rows.keys() == {(scenario, name) for scenario in MANIFEST["scenarios"] for name in MANIFEST["parameters"]}
    assert [rows["free", name] for name in ("v0", "T", "unused")] == [True, False, False]
    assert [rows["behind", name] for name in ("T", "unused")] == [True, False]
    present(client.map_of(studied))


def test_references_answer_cells_by_the_map_and_the_validation_agrees(client: Client, studied: Campaign) -> None:
    assert studied.cells.certified == 0
    assert studied.cells.requested == studied.cells.repeated + studied.cells.reused + studied.cells.simulated
    rows = list(client.validation(studied.id))
    assert {row.scenario for row in rows} == set(MANIFEST["scenarios"])


def test_the_trace_of_a_cell_has_its_measures_and_the_roads_that_it_was_driven_on(client: Client, studied: Campaign) -> None:
    number = client.cell(studied.id, 0, 0, "behind")
    deadline = time.monotonic() + 120
    while (trace := client.trace(str(number))) is None:
        assert time.monotonic() < deadline
        time.sleep(0.5)
    assert isinstance(trace, SeriesAnswer)
    assert trace.series == {}, "the problem declares none"
    replay = present(trace.replay)
    assert [vehicle.id for vehicle in replay.others] == ["leader"]
    assert replay.ego.position_m[-1] - replay.ego.position_m[0] == pytest.approx(trace.measures["distance_m"], abs=0.5)
    assert len(replay.route.lanes) == 3
    (row,) = [row for row in client.rows(studied.id, "evaluations", measures="true", limit=1000) if row["id"] == number]
    assert trace.measures["distance_m"] == row["measure_distance_m"]

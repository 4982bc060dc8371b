"""Vehicles against the route on two-way roads of netgenerate and netconvert, as the controlled vehicle sees and hits them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.motorways import driven, motorway
from tests.support.networks import built, generated

from drivecal.roads.network import read_network

pytestmark = pytest.mark.slow
GRID = ("--grid", "--grid.x-number", "4", "--grid.y-number", "1", "--grid.length", "300", "-L", "2")
CURVE = "0,0 100,0 200,10 290,40 370,90"
HOLD = "def control(observation, parameters):\n    return 0.5 * (20.0 - observation['speed'])\n"
EGO = {"s": 60, "speed": 20}


def drive(folder: Path, network: bytes, way: list[str], lane: int, *, step: float = 0.1, **oncoming: Any) -> Any:
    """A run of 20 m/s on the leftmost lane; the oncoming car keeps 25 m/s."""
    motorway(folder, HOLD)
    (folder / "road.net.xml").write_bytes(network)
    car = {"lane": lane, "speed": 25, "model": "constant", "length": 6.0, "width": 2.0} | oncoming
    data = {"network": "road.net.xml", "route": way, "duration": 10, "ego": EGO | {"lane": lane}, "traffic": [car]}
    with driven(folder, data, step=step) as session:
        outcome = session.evaluate({}, series=True)
    return outcome.failure, outcome.measures, {name: np.array(values) for name, values in outcome.series.items()}


def test_an_oncoming_car_in_its_own_lane_is_no_leader(tmp_path: Path) -> None:
    network = generated(*GRID)
    failure, measures, series = drive(
        tmp_path / "b", network, ["A0B0", "B0C0", "C0D0"], 1, edge="C0B0", s=100, route=["C0B0", "B0A0"]
    )
    assert failure is None
    assert (measures["min_gap_m"], measures["min_ttc_s"], measures["min_rear_ttc_s"]) == (1000, 100, 100)
    assert np.all(series["rear_gap_m"] == 1000)


def test_a_car_on_the_wrong_side_is_met_at_both_speeds(tmp_path: Path) -> None:
    network = generated(*GRID)
    place: dict[str, Any] = {"edge": "C0B0", "s": 100, "offset": 3.2, "route": ["C0B0", "B0A0"]}
    failure, measures, series = drive(tmp_path / "b", network, ["A0B0", "B0C0", "C0D0"], 1, **place)
    begin = read_network(network, "r").edges["C0B0"].lanes[1].shape[0, 0]
    assert series["gap_m"][0] == pytest.approx(begin - 100 - series["x_m"][0] - 0.5 * (4.7 + 6.0), abs=0.01)
    assert series["leader_speed_mps"] == pytest.approx(np.full(len(series["gap_m"]), -25))
    assert np.diff(series["gap_m"]) == pytest.approx(
        np.full(len(series["gap_m"]) - 1, -4.5), abs=0.11
    )  # SUMO loses 0.1 m between two edges
    assert series["gap_m"][0] / 45 == pytest.approx(measures["duration_s"], abs=0.11)
    assert failure == "collision"


@pytest.mark.parametrize(("offset", "failure"), [(0.0, None), (0.5, None), (2.6, "collision")])
def test_an_oncoming_car_on_a_curve_is_hit_if_it_crosses_the_middle(tmp_path: Path, offset: float, failure: str | None) -> None:
    points = CURVE.split()
    nodes = [
        {"id": name, "x": point.split(",")[0], "y": point.split(",")[1]}
        for name, point in (("a", points[0]), ("b", points[-1]))
    ]
    edges = [
        {"id": "there", "from": "a", "to": "b", "numLanes": "1", "speed": "30", "shape": CURVE},
        {"id": "back", "from": "b", "to": "a", "numLanes": "1", "speed": "30", "shape": " ".join(reversed(points))},
    ]
    network = built(nodes, edges)
    ended, measures, _ = drive(tmp_path / "b", network, ["there"], 0, edge="back", s=60, offset=offset)
    assert ended == failure
    assert (measures["min_gap_m"] < 1000) is (failure is not None)


@pytest.mark.parametrize(
    ("step", "place"),
    [
        (0.5, {"edge": "A0B0", "s": 125, "speed": 0, "length": 0.5}),
        (0.2, {"edge": "C0B0", "s": 100, "offset": 3.2, "speed": 60, "length": 0.5, "route": ["C0B0", "B0A0"]}),
    ],
)
def test_no_vehicle_drives_through_another_one_within_a_step(step: float, place: dict[str, Any], tmp_path: Path) -> None:
    """Only the ends of steps are recorded, and here none of them has an overlap."""
    network = generated(*GRID)
    failure, _, series = drive(tmp_path / "b", network, ["A0B0", "B0C0", "C0D0"], 1, step=step, **place)
    assert failure == "collision"
    assert abs(series["gap_m"][-2]) > 0.2
    assert series["gap_m"][-1] == 1000

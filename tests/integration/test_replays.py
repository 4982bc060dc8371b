"""Replays of real runs on networks of users: the vehicles drive on the lanes that are drawn, at their places in the network."""

import numpy as np
import pytest
from tests.support.motorways import EVERYTHING, PARAMETERS, driven, motorway
from tests.support.networks import entrance

from drivecal.contracts.evaluation import ReplayAnswer, RoadSurface
from drivecal.plugins.simulators import RunOutcome

pytestmark = pytest.mark.slow
MERGE = {
    "network": "merge.net.xml",
    "route": ["before", "beside", "after"],
    "duration": 12.0,
    "ego": {"lane": 0, "s": 250, "speed": 26},
    "traffic": [
        {"id": "joins", "edge": "ramp", "route": ["ramp", "beside", "after"], "s": 60, "speed": 20, "lane_change": "LC2013"},
        {"id": "leads", "lane": 1, "s": 330, "speed": 26},
    ],
}


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> RunOutcome:
    folder = motorway(tmp_path_factory.mktemp("replays") / "bundle")
    (folder / "merge.net.xml").write_bytes(entrance())
    with driven(folder, MERGE) as session:
        assert session.evaluate(PARAMETERS).replay is None
        return session.evaluate(PARAMETERS, series=True)


def replay_of(outcome: RunOutcome) -> ReplayAnswer:
    assert outcome.failure is None
    assert outcome.replay is not None
    return outcome.replay


def test_the_ego_vehicle_is_where_its_series_say(outcome: RunOutcome) -> None:
    replay = replay_of(outcome)
    series, ego = outcome.series, replay.ego
    assert set(EVERYTHING.series) == set(series)
    for name, values in {"time_s": replay.time_s, "x_m": ego.x_m, "y_m": ego.y_m, "position_m": ego.position_m}.items():
        assert values == pytest.approx(series[name], abs=0.01)
    assert np.array(ego.heading_rad) == pytest.approx(np.array(series["heading_rad"]), abs=1e-3)


def test_vehicles_drive_on_the_lanes_and_one_from_a_ramp_to_the_route(outcome: RunOutcome) -> None:
    replay = replay_of(outcome)
    others = {vehicle.id: vehicle for vehicle in replay.others}
    assert others.keys() == {"joins", "leads"}
    joins = np.column_stack([others["joins"].x_m, others["joins"].y_m])
    assert len(joins) == len(replay.time_s)
    assert distance(replay.route, joins[0]) > 2.0
    assert distance(replay.route, joins[-1]) < 2.0
    leads = np.column_stack([others["leads"].x_m, others["leads"].y_m])
    ego = np.column_stack([replay.ego.x_m, replay.ego.y_m])
    assert max(distance(replay.route, place) for place in [*leads, *ego]) < 2.0


def distance(surface: RoadSurface, place: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
    """Distance from the nearest centre of a drawn lane."""
    least = np.inf
    for strip in surface.lanes:
        centre = 0.5 * (np.array(strip.right) + np.array(strip.left))
        ways = np.diff(centre, axis=0)
        share = np.clip(((place - centre[:-1]) * ways).sum(axis=1) / (ways**2).sum(axis=1).clip(1e-12), 0.0, 1.0)
        least = min(least, float(np.hypot(*(centre[:-1] + share[:, None] * ways - place).T).min()))
    return least

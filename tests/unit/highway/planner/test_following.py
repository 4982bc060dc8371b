"""The desired speed behind a slower vehicle on a corridor."""

import numpy as np
import pytest

from drivecal.domain.roads import Floats
from drivecal.highway.planner.cost import LATEST_DECELERATION
from drivecal.highway.planner.following import SHORTEST_GAP, SHORTEST_HEADWAY, follow, speed_behind
from drivecal.highway.planner.plans import SPACING

ROWS = 1000
SCENE = np.array([0.0, 3.5, 0.0, 2.5, 1.0, -2.0, 2.0, 0.1])
EGO = np.array([100.0, 28.0, 0.0, 0.0, 0.0, 0.0])
WANTED = np.full(ROWS, 28.0)


def lowered(
    *neighbours: list[float], accelerations: list[float] | None = None, wanted: Floats = WANTED
) -> tuple[Floats, Floats]:
    """The desired speed and its change along a straight road, with neighbours (s, d, s', d', length, width)."""
    road = np.zeros((ROWS, 10))
    road[:, 0] = np.arange(ROWS) * SPACING
    others = np.array(neighbours).reshape(-1, 6)
    outlines = np.zeros((len(others), 7))
    outlines[:, 6] = accelerations or 0.0
    follow(road, wanted, SCENE, EGO, others, outlines, True)
    return road[:, 5], road[:, 9]


def at(speeds: Floats, s: float) -> float:
    return float(speeds[int(s / SPACING)])


@pytest.mark.parametrize(
    "neighbour",
    [
        [60.0, 0.0, 9.0, 0.0, 5.0, 2.0],  # behind
        [150.0, 3.5, 9.0, 0.0, 5.0, 2.0],  # beside
        [150.0, 0.0, 28.0, 0.0, 5.0, 2.0],  # as fast
    ],
)
def test_a_vehicle_out_of_the_way_changes_nothing(neighbour: list[float]) -> None:
    speeds, changes = lowered(neighbour)
    assert np.array_equal(speeds, WANTED)
    assert not changes.any()


def test_ahead_of_a_slow_leader_the_speed_falls_to_its_own_no_faster_than_at_the_latest_deceleration() -> None:
    speeds, changes = lowered([210.0, 0.0, 9.0, 0.0, 5.0, 2.0])
    assert at(speeds, 100) == 28.0
    assert 9.0 < speeds[-1] < 13.0  # it comes closer beyond the horizon
    assert np.all(changes <= 0.0)
    decelerations = -changes * speeds
    assert 2.0 < decelerations.max() < LATEST_DECELERATION
    assert np.allclose(np.diff(speeds) / SPACING, changes[:-1])


def test_a_vehicle_that_drifts_into_the_way_or_brakes_is_foreseen() -> None:
    drifting, _ = lowered([140.0, 3.5, 9.0, -1.5, 5.0, 2.0])
    assert at(drifting, 100) < 28.0
    steady, _ = lowered([150.0, 0.0, 24.0, 0.0, 5.0, 2.0])
    braking, _ = lowered([150.0, 0.0, 24.0, 0.0, 5.0, 2.0], accelerations=[-4.0])
    assert at(steady, 100) == at(braking, 100)
    assert at(braking, 180) < at(steady, 180) - 5.0
    assert braking.min() >= 0.0


def test_the_slowest_way_ahead_counts_and_a_wrong_way_driver_stops_it() -> None:
    far, near = [300.0, 0.0, 9.0, 0.0, 5.0, 2.0], [140.0, 0.0, 20.0, 0.0, 5.0, 2.0]
    assert np.array_equal(lowered(far, near)[0], lowered(near)[0])
    assert lowered([180.0, 0.0, -20.0, 0.0, 5.0, 2.0])[0][-1] == 0.0


def test_the_leader_s_speed_is_wanted_at_the_shortest_gap() -> None:
    for speed in (0.0, 9.0, 25.0):
        gap = SHORTEST_GAP + SHORTEST_HEADWAY * speed
        assert speed_behind(gap, speed) == pytest.approx(speed)
        assert speed_behind(gap - 1.0, speed) < speed or speed == 0.0
        assert speed_behind(gap + 1.0, speed) > speed
    assert speed_behind(-100.0, 3.0) == 0.0

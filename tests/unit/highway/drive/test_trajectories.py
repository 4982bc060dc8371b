"""Trajectories of users' points: checked, joined smoothly, and laid along the track."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from tests.support.motorways import NETWORK, ROUTE

from drivecal.highway.drive.controllers import ControllerError
from drivecal.highway.drive.road import HighwayRoad
from drivecal.highway.drive.trajectories import STEP, checked_points, trajectory_of
from drivecal.roads.corridor import corridor
from drivecal.roads.network import read_network


@cache
def road() -> HighwayRoad:
    """The examples' motorway: straight up to s = 600, then a left curve with a radius of 1,000 m up to 1,400."""
    return HighwayRoad(corridor(read_network(NETWORK.read_bytes(), "road.net.xml"), ROUTE, "road.net.xml"), {})


@pytest.mark.parametrize(
    ("points", "needed"),
    [
        (None, 0.2),
        (3.0, 0.2),
        ([], 0.2),
        ([[0, 1]], 0.2),
        ([[0, 1, 0]], 0.2),
        ([[0, 1, 0], [1, "x", 0]], 0.2),
        ([[0, 1, 0], [1, float("nan"), 0]], 0.2),
        ([[0, 1, 0], [1, 1e300, 0]], 0.2),
        ([[0, 1, 0], [0, 2, 0], [1, 3, 0]], 0.2),
        ([[0.1, 1, 0], [1, 2, 0]], 0.2),
        ([[0, 1, 0], [0.1, 2, 0]], 0.2),
        ([[0, 1, 0], [1, 2]], 0.2),
        ([[0.001 * n, n, 0] for n in range(10_001)], 0.2),
    ],
)
def test_what_is_no_trajectory_is_named(points: Any, needed: float) -> None:
    with pytest.raises(ControllerError, match="trajectory at 3 s"):
        checked_points(points, needed, 3.0)


def test_a_trajectory_lies_on_its_track_with_the_speed_and_curvature_of_the_drive() -> None:
    for track, offset in ((0, 0.0), (1, -0.6)):
        points = checked_points([[0.25 * n, 800 + 30 * 0.25 * n, offset] for n in range(13)], 0.2, 0.0)
        rows = trajectory_of(road(), track, points)
        assert np.allclose(np.diff(rows[:, 0]), STEP)
        line, centres = road().line, road().lanes[:, track, 0]
        s = 800 + 30 * rows[:, 0]
        d = np.interp(s, line[:, 0], centres) + offset
        x, y, heading, curvature = (np.interp(s, line[:, 0], line[:, column]) for column in range(1, 5))
        assert np.abs(rows[:, 1] - (x - d * np.sin(heading))).max() < 1e-3
        assert np.abs(rows[:, 2] - (y + d * np.cos(heading))).max() < 1e-3
        assert np.abs(rows[:, 3] - heading).max() < 0.04  # a chord of 60 m differs by 0.03 rad from the arc
        assert np.allclose(rows[:, 4], curvature / (1 - curvature * d), atol=1e-5)
        assert np.allclose(rows[:, 5], 30 * (1 - curvature * d), atol=0.03)


def test_points_are_joined_without_corners() -> None:
    points = checked_points([[0, 100, 0], [1, 130, 0], [2, 160, 1], [3, 190, 1], [4, 220, 1]], 0.2, 0.0)
    rows = trajectory_of(road(), 0, points)
    assert np.abs(np.diff(rows[:, 3])).max() < 0.01
    at = {round(time, 2): row for time, row in zip(rows[:, 0].tolist(), rows, strict=True)}
    centre = road().lanes[0, 0, 0]
    across = -np.sin(road().line[0, 3]), np.cos(road().line[0, 3])
    for time, offset in ((1.0, 0.0), (2.0, 1.0), (3.0, 1.0)):
        off = (at[time][1:3] - road().line[0, 1:3]) @ across
        assert off == pytest.approx(centre + offset, abs=1e-4)


def test_a_trajectory_beyond_the_end_of_the_route_goes_straight_on() -> None:
    length = road().length
    rows = trajectory_of(road(), 0, checked_points([[0, length - 10, 0], [1, length + 20, 0]], 0.2, 0.0))
    assert np.allclose(rows[:, 5], 30, atol=0.05)


@pytest.mark.parametrize(("last", "needed"), [(0.01, 0.01), (0.12, 0.12), (30.0, 25.0)])
def test_a_trajectory_covers_what_is_needed_and_goes_straight_on_in_its_last_row(last: float, needed: float) -> None:
    points = checked_points([[0, 100, 0], [last, 100 + 10 * last, 0]], needed, 0.0)
    rows = trajectory_of(road(), 0, points, needed)
    assert len(rows) >= 2
    assert rows[-1, 0] >= needed - 1e-9
    assert np.allclose(rows[:, 5], 10)

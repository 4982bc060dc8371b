"""Drives as a replay shows them: the ego vehicle, and each other vehicle as long as it is near."""

import tracemalloc
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import pytest
from tests.support.networks import real_corridor
from tests.support.roads import to_cartesian
from tests.support.values import present

from drivecal.contracts.evaluation import ReplayAnswer
from drivecal.domain.roads import Floats
from drivecal.highway.drive import replay as replays
from drivecal.highway.drive.measures import COLUMNS, Record
from drivecal.highway.drive.replay import REACH, DriveRecorder
from drivecal.highway.drive.traffic import Traffic

ROAD = real_corridor("motorway")
STEP, SPEED = 0.1, 30.0


def rows(times: npt.NDArray[np.floating[Any]]) -> Floats:
    """Rows of a record along the route from s = 100 on."""
    table = np.zeros((len(times), len(COLUMNS)))
    for row, time in zip(table, times.tolist(), strict=True):
        s = 100.0 + SPEED * time
        row[: len(COLUMNS)] = 0.0
        row[:5] = (time, *to_cartesian(ROAD.line, s, 0.0), s)
        row[COLUMNS.index("speed_mps")] = SPEED
    return table


def shown(names: list[str], outlines: Floats) -> Traffic:
    """Traffic with these vehicles."""
    return cast("Traffic", SimpleNamespace(names=names, outlines=outlines))


def recorded(table: Floats, others: list[dict[str, float]]) -> ReplayAnswer | None:
    """The replay of a drive, at whose moments `others` are as far ahead (m) as given by their names."""
    recorder = DriveRecorder(table[1, 0] - table[0, 0])
    for row, ahead in zip(table, others, strict=False):
        places = [
            (np.nan, np.nan, 0.0) if np.isnan(gap) else to_cartesian(ROAD.line, row[4] + gap, 0.0) for gap in ahead.values()
        ]
        outlines = np.array([[*place, 2.5, 0.9, SPEED] for place in places]).reshape(-1, 6)
        recorder(shown(list(ahead), outlines), row[1:4], None)
        outlines[:] = np.nan  # the next step overwrites it
    record = Record(table, np.zeros((0, 5)), 1.0, 1.0, 1.9)
    return recorder.replay(record, 4.7, ROAD)


def test_a_vehicle_that_comes_back_is_there_twice() -> None:
    near, far = {"a": 20.0, "b": 50.0}, {"a": 20.0, "b": REACH + 50.0}
    replay = present(recorded(rows(np.arange(6) * STEP), [near, near, far, far, near, near]))
    assert [(vehicle.id, vehicle.first, len(vehicle.x_m)) for vehicle in replay.others] == [
        ("a", 0, 6),
        ("b", 0, 2),
        ("b", 4, 2),
    ]
    assert (replay.others[0].length_m, replay.others[0].width_m) == (5.0, 1.8)
    assert (replay.ego.length_m, replay.ego.width_m, len(replay.ego.x_m)) == (4.7, 1.9, 6)
    assert replay.time_s == pytest.approx(np.arange(6) * STEP)


def test_vehicles_on_other_levels_are_left_out() -> None:
    replay = present(recorded(rows(np.arange(3) * STEP), [{"above": np.nan, "a": 20.0}] * 3))
    assert [vehicle.id for vehicle in replay.others] == ["a"]


def test_a_run_that_ends_within_a_step_shows_the_others_at_its_end() -> None:
    replay = present(recorded(rows(np.array([0.0, 0.1, 0.2, 0.25])), [{"a": 20.0}] * 3))
    (other,) = replay.others
    assert len(other.x_m) == len(replay.ego.x_m) == 4
    ways = np.hypot(np.diff(other.x_m), np.diff(other.y_m))
    assert ways == pytest.approx([3.0, 3.0, 1.5], abs=0.03)


def test_an_unstable_vehicle_is_shown_up_to_its_last_place() -> None:
    table = rows(np.arange(4) * STEP)
    table[3, 1:5] = np.nan
    replay = present(recorded(table, [{}] * 4))
    assert len(replay.time_s) == 3
    table[1, 1] = np.inf
    assert recorded(table, [{}] * 4) is None


def test_long_and_full_runs_are_shown_at_fewer_moments(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replays, "MOST_POSES", 40)
    replay = present(recorded(rows(np.arange(51) * 0.02), [{"a": 20.0, "b": 40.0}] * 51))
    assert replay.time_s == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
    monkeypatch.setattr(replays, "MOST_MOMENTS", 4)
    fewer = present(recorded(rows(np.arange(51) * 0.02), [{}] * 51))
    assert fewer.time_s == pytest.approx([0.0, 0.4, 0.8, 1.0])
    monkeypatch.setattr(replays, "MOST_POSES", 5)
    fuller = present(recorded(rows(np.arange(51) * 0.02), [{"a": 20.0, "b": 40.0}] * 51))
    assert fuller.time_s == pytest.approx([0.0, 0.8, 1.0])
    assert [len(vehicle.x_m) for vehicle in fuller.others] == [3, 3]


@pytest.mark.parametrize(("step", "apart"), [(0.01, 0.1), (0.04, 0.12), (0.07, 0.14), (0.1, 0.1), (0.5, 0.5)])
def test_moments_are_at_least_a_tenth_of_a_second_apart_but_for_the_last(step: float, apart: float) -> None:
    times = np.arange(50) * step
    replay = present(recorded(rows(times), [{}] * len(times)))
    assert replay.time_s[-1] == pytest.approx(times[-1])
    assert np.diff(replay.time_s[:-1]) == pytest.approx(np.full(len(replay.time_s) - 2, apart))


def test_the_memory_of_a_recorder_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replays, "MOST_MOMENTS", 20)
    monkeypatch.setattr(replays, "MOST_POSES", 300)
    names = [f"v{number}" for number in range(25)]
    outlines = np.tile([0.0, 0.0, 0.0, 2.5, 0.9, SPEED], (len(names), 1))
    recorder, pose = DriveRecorder(0.01), np.zeros(3)

    def record(moments: int) -> None:
        for _ in range(moments):
            recorder(shown(names, outlines), pose, None)

    record(1000)
    tracemalloc.start()
    try:
        record(2000)
        assert tracemalloc.get_traced_memory()[0] < 2 * 300 * outlines[0].nbytes
    finally:
        tracemalloc.stop()

"""Measures of runs against hand-made cases."""

import math
from typing import Any

import numpy as np
import pytest

from drivecal.bundles.highway_catalogue import FAR, LONGEST, MEASURES
from drivecal.highway.drive.measures import COLUMNS, Record, distance_at_limit, energy, jerks, measures, times_to_collision

STEP = 0.1


def record(columns: dict[str, Any] | None = None, dynamics: dict[int, Any] | None = None, steps: int = 10) -> Record:
    """A drive at 20 m/s in the middle of a lane, alone, with other columns."""
    rows = np.zeros((steps + 1, len(COLUMNS) + 6))
    usual: dict[str, Any] = {
        "time_s": np.arange(steps + 1) * STEP,
        "position_m": 100 + np.arange(steps + 1) * 20 * STEP,
        "speed_mps": 20.0,
        "limit_mps": 30.0,
        "gap_m": FAR,
        "rear_gap_m": FAR,
        "leader_speed_mps": 20.0,
        "follower_speed_mps": 20.0,
        "lane_width_m": 3.5,
    }
    for name, values in (usual | (columns or {})).items():
        rows[:, COLUMNS.index(name)] = values
    samples = np.zeros((steps * 10, 5))
    samples[:, 0] = 20.0
    for column, values in (dynamics or {}).items():
        samples[:, column] = values
    return Record(rows, samples, 30.0, 1000.0, 2.0)


def measured(record: Record) -> dict[str, float]:
    return measures(record, 2000.0)


def test_every_measure_of_the_catalogue_is_there_and_finite() -> None:
    values = measured(record())
    assert values.keys() == MEASURES.keys()
    assert all(math.isfinite(value) for value in values.values())


def test_a_run_without_others_measures_the_largest_values() -> None:
    values = measured(record())
    assert (values["min_ttc_s"], values["min_headway_s"], values["mean_headway_s"]) == (LONGEST, LONGEST, LONGEST)
    assert (values["min_gap_m"], values["mean_gap_m"]) == (FAR, FAR)
    assert (values["max_drac_mps2"], values["time_exposed_ttc_s"]) == (0, 0)


def test_gaps_headways_and_times_to_collision() -> None:
    gap = np.array([FAR, FAR, 60, 40, 20, 10, 8, 8, 9, 10, 12], dtype=float)
    leader = np.array([20, 20, 10, 10, 10, 15, 20, 21, 22, 22, 22], dtype=float)
    values = measured(record({"gap_m": gap, "leader_speed_mps": leader}))
    assert values["min_gap_m"] == 8
    assert values["mean_gap_m"] == pytest.approx(gap[2:].mean())
    assert values["min_ttc_s"] == pytest.approx(2.0)
    assert values["time_exposed_ttc_s"] == pytest.approx(2 * STEP)  # 20 m at 10 m/s, 10 m at 5 m/s
    assert values["min_headway_s"] == pytest.approx(0.4)
    assert values["mean_headway_s"] == pytest.approx((gap[2:] / 20).mean())
    assert values["max_drac_mps2"] == pytest.approx(10**2 / (2 * 20))


def test_the_follower_s_time_to_collision_counts_on_its_own() -> None:
    values = measured(record({"rear_gap_m": 15.0, "follower_speed_mps": 25.0}))
    assert (values["min_rear_ttc_s"], values["min_ttc_s"]) == (3.0, LONGEST)


def test_no_gap_that_closes_is_no_time_left() -> None:
    times = times_to_collision(np.array([5.0, -1.0, -1.0, FAR]), np.array([-1.0, 1.0, -1.0, 5.0]))
    assert times.tolist() == [LONGEST, 0.0, LONGEST, LONGEST]


def test_a_standing_vehicle_has_no_headway() -> None:
    values = measured(record({"gap_m": 3.0, "speed_mps": 0.0}))
    assert (values["min_headway_s"], values["mean_headway_s"]) == (LONGEST, LONGEST)


def test_way_speed_and_progress() -> None:
    values = measured(record({"limit_mps": 19.0}))
    assert values["duration_s"] == pytest.approx(1)
    assert values["distance_m"] == pytest.approx(20)
    assert values["mean_speed_mps"] == pytest.approx(20)
    assert values["progress"] == pytest.approx(20 / 30)
    assert values["max_speed_excess_mps"] == pytest.approx(1)


def test_the_way_at_the_limit_begins_at_the_start_and_ends_at_the_end_of_the_route() -> None:
    s, limits = np.array([0.0, 100.0, 200.0]), np.array([10.0, 20.0, 20.0])
    assert distance_at_limit(s, limits, 50.0, 190.0, 4.0) == pytest.approx(40)
    assert distance_at_limit(s, limits, 50.0, 190.0, 7.0) == pytest.approx(50 + 40)
    assert distance_at_limit(s, limits, 50.0, 190.0, 60.0) == pytest.approx(140)


def test_a_drive_beyond_the_end_of_the_route_makes_no_further_progress() -> None:
    whole = record({"position_m": 980 + np.arange(11) * 2.1})
    assert measured(whole)["progress"] == pytest.approx(20 / 30)


def test_a_last_step_that_is_cut_short_counts_as_long_as_it_took() -> None:
    times = np.append(np.arange(10) * STEP, 0.93)
    values = measured(record({"time_s": times, "gap_m": 20.0, "leader_speed_mps": 10.0}))
    assert values["time_exposed_ttc_s"] == pytest.approx(0.93)


def test_percentiles_and_jerks_of_accelerations() -> None:
    along = np.linspace(-4, 2, 100)
    values = measured(record(dynamics={1: along, 2: np.full(100, -1.5)}))
    assert values["max_acceleration_mps2"] == 2
    assert values["max_deceleration_mps2"] == 4
    assert values["rms_acceleration_mps2"] == pytest.approx(np.sqrt((along**2).mean()))
    assert values["p95_acceleration_mps2"] == pytest.approx(np.quantile(np.abs(along), 0.95))
    assert values["max_lateral_acceleration_mps2"] == values["p95_lateral_acceleration_mps2"] == 1.5
    ramp = np.arange(1, 201, dtype=np.float64) * np.float64(0.02)  # 2 m/s³, starting at rest
    assert jerks(ramp)[60:] == pytest.approx(np.full(140, 2.0))
    assert jerks(ramp)[0] == pytest.approx(0.04)


def test_lane_departures_and_changes_are_counted() -> None:
    offset = np.array([0, 0.5, 0.8, 0.9, 0.5, -0.8, -0.8, 0, 0, 0, 0])
    lane = np.array([0, 0, 0, 0, 0, 1, 1, 1, 0, 0, 0])
    values = measured(record({"offset_m": offset, "lane": lane}))
    assert values["lane_departures"] == 2  # half a lane less half a vehicle is 0.75 m
    assert values["lane_changes"] == 2
    assert values["max_lane_offset_m"] == 0.9
    assert values["rms_lane_offset_m"] == pytest.approx(np.sqrt((offset**2).mean()))


def test_energy_is_that_of_the_stated_vehicle() -> None:
    cruise = np.zeros((6000, 5))
    cruise[:, 0] = 30.0
    power = (0.01 * 2000 * 9.81 + 0.39 * 30**2) * 30
    assert energy(cruise, 2000.0) == pytest.approx(power * 60 / 0.9 / 3.6e6)
    braking = cruise.copy()
    braking[:, 1] = -3.0
    assert energy(braking, 2000.0) == pytest.approx(0.6 * (power - 1.05 * 2000 * 3 * 30) * 60 / 3.6e6)

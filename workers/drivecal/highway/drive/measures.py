"""Measures and time series of a run, from its record. Pure. Formulas: `bundles/highway.md`."""

from dataclasses import dataclass

import numpy as np

from drivecal.bundles.highway_catalogue import FAR, LONGEST, SERIES
from drivecal.domain.roads import Floats

COLUMNS = tuple(SERIES)
"""Columns of a record, as `geometry.record` writes them."""
TICK = 0.01
"""Sample time of `dynamics` (s)."""
JERK_SAMPLES = 50
"""Samples over which a jerk is taken: 0.5 s."""
CRITICAL = 3.0
"""Time to collision (s) below which its duration counts."""
STANDSTILL = 0.1
"""Own speed (m/s) below which the time headway is undefined."""
GRAVITY = 9.81
ROLLING, DRAG, ROTATING, DRIVE, RECUPERATION = 0.01, 0.5 * 1.2 * 0.65, 1.05, 0.9, 0.6
"""The vehicle of `energy_kwh`: battery electric, on a level road."""


@dataclass(frozen=True, slots=True)
class Record:
    """Record of a run.

    `rows`, shape (n + 1, 23): `COLUMNS` and the Frenet motion, at the start, after each step of the traffic, and at the end. `dynamics`:
    after each 0.01 s, shape (m, 5): speed, longitudinal and lateral acceleration, yaw rate, steering angle. `wanted`: distance (m) of a
    drive at the limit for the scenario's duration. `finish`: position (m) at which the route ends for the vehicle's centre. `width`: the
    vehicle's.
    """

    rows: Floats
    dynamics: Floats
    wanted: float
    finish: float
    width: float

    @property
    def motion(self) -> Floats:
        """s, s', s'', d, d', d'' of the vehicle in each row, shape (n + 1, 6)."""
        return self.rows[:, len(COLUMNS) :]

    def column(self, name: str) -> Floats:
        """Returns a column of `rows`."""
        column: Floats = self.rows[:, COLUMNS.index(name)]
        return column


def measures(record: Record, mass: float) -> dict[str, float]:
    """Returns all measures by name, of a vehicle with this mass (kg)."""
    duration = len(record.dynamics) * TICK
    distance = float(record.dynamics[:, 0].sum() * TICK)
    position = record.column("position_m")
    values = {
        "duration_s": duration,
        "distance_m": distance,
        "mean_speed_mps": distance / duration,
        "progress": float(min(position[-1], record.finish) - position[0]) / record.wanted,
        "max_speed_excess_mps": max(0.0, float(np.max(record.column("speed_mps") - record.column("limit_mps")))),
        "energy_kwh": energy(record.dynamics, mass),
    }
    return values | _of_gaps(record) | _of_accelerations(record.dynamics) | _of_lanes(record)


def distance_at_limit(s: Floats, limits: Floats, start: float, finish: float, duration: float) -> float:
    """Returns the distance (m) that a drive at the speed limit covers.

    Args:
        s: positions along the route (m), shape (n,).
        limits: limit (m/s) from each row of `s` to the next, shape (n,).
        start: position at which the drive begins.
        finish: position at which it ends at the latest.
        duration: its time (s).
    """
    times = np.concatenate([[0.0], np.cumsum(np.diff(s) / limits[:-1])])
    end = float(np.interp(np.interp(start, s, times) + duration, times, s))
    return min(end, finish) - start


def _of_gaps(record: Record) -> dict[str, float]:
    speed, gap = record.column("speed_mps"), record.column("gap_m")
    steps = np.diff(record.column("time_s"))  # the last one may be shorter
    times = times_to_collision(gap, speed - record.column("leader_speed_mps"))
    led = gap < FAR
    moving = led & (speed > STANDSTILL)
    headways = np.minimum(np.maximum(gap[moving], 0.0) / speed[moving], LONGEST)
    closing = np.maximum(speed - record.column("leader_speed_mps"), 0.0)[led]
    rear = times_to_collision(record.column("rear_gap_m"), record.column("follower_speed_mps") - speed)
    return {
        "min_ttc_s": float(times.min()),
        "time_exposed_ttc_s": float(steps[times[1:] < CRITICAL].sum()),
        "min_headway_s": float(headways.min(initial=LONGEST)),
        "mean_headway_s": float(headways.mean()) if headways.size else LONGEST,
        "min_gap_m": float(gap.min()),
        "mean_gap_m": float(gap[led].mean()) if led.any() else FAR,
        "max_drac_mps2": float((closing**2 / (2.0 * np.maximum(gap[led], 0.1))).max(initial=0.0)),
        "min_rear_ttc_s": float(rear.min()),
    }


def times_to_collision(gap: Floats, closing: Floats) -> Floats:
    """Returns gap / closing speed, `LONGEST` at most and if the gap does not close, 0 if there is none left."""
    times = np.full(len(gap), LONGEST)
    closes = (closing > 0.0) & (gap < FAR)
    times[closes] = np.maximum(gap[closes], 0.0) / closing[closes]
    return np.minimum(times, LONGEST)


def _of_accelerations(dynamics: Floats) -> dict[str, float]:
    along, across = dynamics[:, 1], dynamics[:, 2]
    jerk, lateral_jerk = jerks(along), jerks(across)
    return {
        "max_acceleration_mps2": float(along.max(initial=0.0)),
        "max_deceleration_mps2": float((-along).max(initial=0.0)),
        "rms_acceleration_mps2": _rms(along),
        "p95_acceleration_mps2": _p95(along),
        "p95_lateral_acceleration_mps2": _p95(across),
        "max_lateral_acceleration_mps2": float(np.abs(across).max()),
        "rms_jerk_mps3": _rms(jerk),
        "p95_jerk_mps3": _p95(jerk),
        "p95_lateral_jerk_mps3": _p95(lateral_jerk),
    }


def jerks(accelerations: Floats) -> Floats:
    """Returns (a(t) - a(t - 0.5 s)) / 0.5 s; a vehicle starts without acceleration."""
    before = np.concatenate([np.zeros(JERK_SAMPLES), accelerations])[: len(accelerations)]
    jerk: Floats = (accelerations - before) / (JERK_SAMPLES * TICK)
    return jerk


def _of_lanes(record: Record) -> dict[str, float]:
    offset, lane = record.column("offset_m"), record.column("lane")
    out = np.abs(offset) + 0.5 * record.width > 0.5 * record.column("lane_width_m")
    return {
        "max_lane_offset_m": float(np.abs(offset).max()),
        "rms_lane_offset_m": _rms(offset),
        "lane_departures": float(np.count_nonzero(out[1:] & ~out[:-1])),
        "lane_changes": float(np.count_nonzero(np.diff(lane))),
    }


def energy(dynamics: Floats, mass: float) -> float:
    """Returns the energy (kWh) that a battery gives, see `bundles/highway.md`."""
    speed, acceleration = dynamics[:, 0], dynamics[:, 1]
    force = ROTATING * mass * acceleration + ROLLING * mass * GRAVITY + DRAG * speed**2
    power = force * speed
    return float(np.where(power > 0.0, power / DRIVE, RECUPERATION * power).sum() * TICK / 3.6e6)


def _p95(values: Floats) -> float:
    """Returns the 95th percentile of magnitudes, linear between two of them; a fifth of the time of `np.percentile`."""
    ordered = np.sort(np.abs(values))
    below = int(0.95 * (len(ordered) - 1))
    share = 0.95 * (len(ordered) - 1) - below
    return float(ordered[below] + share * (ordered[min(below + 1, len(ordered) - 1)] - ordered[below]))


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))

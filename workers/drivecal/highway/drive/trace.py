"""Time series of a run for inspection."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from drivecal.domain.evaluations import RunResult
from drivecal.domain.roads import Floats
from drivecal.domain.scenarios import Scenario
from drivecal.highway.drive.measures import TICK, Record
from drivecal.highway.drive.traffic import Traffic

EGO_COLUMNS = (
    "x_m",
    "y_m",
    "heading_rad",
    "speed_mps",
    "side_slip_rad",
    "yaw_rate_radps",
    "longitudinal_acceleration_mps2",
    "lateral_acceleration_mps2",
    "longitudinal_jerk_mps3",
    "lateral_jerk_mps3",
)
PLAN_COLUMNS = ("time_s", "x_m", "y_m", "heading_rad", "curvature_1pm", "speed_mps", "acceleration_mps2")
NEIGHBOUR_COLUMNS = ("s_m", "d_m", "s_dot_mps", "d_dot_mps", "x_m", "y_m", "heading_rad")
PLAN_DIGITS = 6
JERK_SECONDS = 0.5
"""Averaging window of jerk, like that of the peaks in the reference scale."""


@dataclass(frozen=True, slots=True)
class Trace:
    """Time series of a run, with one row after each step. SI units.

    `times`: (n,) s. `ego`: (n, 10), `EGO_COLUMNS`. `frenet`: (n, 2), s and d. `plans`: trajectories by planning time, (m, 7),
    `PLAN_COLUMNS`. `neighbours` by vehicle id, (n, 7), `NEIGHBOUR_COLUMNS`.
    """

    scenario: str
    times: Floats
    ego: Floats
    frenet: Floats
    plans: dict[float, Floats]
    neighbours: dict[str, Floats]
    result: RunResult

    def to_json(self) -> dict[str, Any]:
        """Returns plain data with one list per quantity; plans are rounded to `PLAN_DIGITS` digits."""
        rating = self.result.rating
        return {
            "scenario": self.scenario,
            "score": rating.score,
            "rating": rating.rating,
            "failure": self.result.failure.value if self.result.failure else None,
            "metrics": dict(self.result.metrics),
            "time_s": self.times.tolist(),
            "ego": _columns(("s_m", "d_m"), self.frenet) | _columns(EGO_COLUMNS, self.ego),
            "neighbours": {name: _columns(NEIGHBOUR_COLUMNS, rows) for name, rows in self.neighbours.items()},
            "plans": [
                {"made_at_s": time} | _columns(PLAN_COLUMNS, plan.round(PLAN_DIGITS)) for time, plan in self.plans.items()
            ],
        }


def _columns(names: tuple[str, ...], rows: Floats) -> dict[str, list[float]]:
    return {name: column.tolist() for name, column in zip(names, rows.T, strict=True)}


class Recorder:
    """Records a run as the closed loop's `Watcher`."""

    def __init__(self, scenario: Scenario) -> None:
        """Records one run of a scenario."""
        self._scenario = scenario
        self._poses: list[Floats] = []
        self._others: dict[str, list[Floats]] = {vehicle.id: [] for vehicle in scenario.traffic}
        self._plans: dict[float, Floats] = {}

    def __call__(self, traffic: Traffic, pose: Floats, plan: Floats | None) -> None:
        if plan is not None:
            self._plans[round((len(self._poses) - 1) * self._scenario.step, 9)] = plan.copy()
        self._poses.append(pose.copy())
        for name, row in zip(traffic.names, np.hstack([traffic.neighbours[:, :4], traffic.outlines[:, :3]]), strict=True):
            self._others[name].append(row)

    def trace(self, record: Record, result: RunResult) -> Trace:
        """Returns the recorded run. A last step that left the road has no row, because SUMO never received it."""
        n = len(self._poses) - 1
        poses = np.array(self._poses[1:]).reshape(n, len(EGO_COLUMNS) - 2)
        return Trace(
            scenario=self._scenario.id,
            times=np.arange(1, n + 1, dtype=np.float64) * self._scenario.step,
            ego=np.hstack([poses, self._jerks(record.dynamics, n)]),
            frenet=record.motion[1 : n + 1, [0, 3]].copy(),
            plans=self._plans,
            neighbours={name: _turned(np.array(rows[1:]).reshape(-1, 7)) for name, rows in self._others.items()},
            result=result,
        )

    def _jerks(self, dynamics: Floats, n: int) -> Floats:
        """Returns longitudinal and lateral jerk over the last `JERK_SECONDS`, after each of n steps, shape (n, 2)."""
        samples = round(self._scenario.step / TICK)
        ends = np.arange(1, n + 1) * samples - 1
        begins = np.maximum(ends - round(JERK_SECONDS / TICK), 0)
        seconds = (ends - begins)[:, None] * TICK
        return np.asarray((dynamics[ends, 1:3] - dynamics[begins, 1:3]) / np.maximum(seconds, TICK))


def _turned(rows: Floats) -> Floats:
    """Turns the headings of moving vehicles, so far the road's, by their lateral motion."""
    rows[:, 6] += np.where(rows[:, 2] > 1.0, np.arctan2(rows[:, 3], rows[:, 2]), 0.0)
    return rows

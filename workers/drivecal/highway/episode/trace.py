"""Time series of a run for inspection."""

from dataclasses import dataclass, field
from math import atan2
from typing import Any

import numpy as np

from drivecal.domain.evaluations import RunResult
from drivecal.domain.roads import Floats, reference_line, to_cartesian
from drivecal.domain.scenarios import Scenario
from drivecal.highway.episode.loop import SAMPLE_TIME, Drive

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


@dataclass(slots=True)
class Recorder:
    """Records a run as the closed loop's `Watcher`."""

    scenario: Scenario
    _poses: list[Floats] = field(default_factory=list)
    _neighbours: list[Floats] = field(default_factory=list)
    _plans: dict[float, Floats] = field(default_factory=dict)

    def __call__(self, index: int, plan: Floats | None, pose: Floats, neighbours: Floats) -> None:
        """Records step `index`."""
        self._poses.append(pose.copy())
        self._neighbours.append(neighbours[:, :4].copy())
        if plan is not None:
            self._plans[round(index * self.scenario.step, 9)] = plan.copy()

    def trace(self, drive: Drive, result: RunResult) -> Trace:
        """Returns the recorded run. A last step that left the road has no row, because SUMO never received it."""
        n = len(self._poses)
        neighbours = self._with_poses(np.array(self._neighbours).reshape(n, len(self.scenario.traffic), 4))
        return Trace(
            scenario=self.scenario.id,
            times=np.arange(1, n + 1, dtype=np.float64) * self.scenario.step,
            ego=np.hstack([np.array(self._poses).reshape(n, len(EGO_COLUMNS) - 2), self._jerks(drive.dynamics, n)]),
            frenet=drive.motion[1 : n + 1, [0, 3]].copy(),
            plans=self._plans,
            neighbours={vehicle.id: neighbours[:, index] for index, vehicle in enumerate(self.scenario.traffic)},
            result=result,
        )

    def _with_poses(self, frenet: Floats) -> Floats:
        """Adds Cartesian poses to neighbours; a vehicle's heading is that of the road plus its lateral motion."""
        line = reference_line(self.scenario.road)
        neighbours = np.empty((*frenet.shape[:2], len(NEIGHBOUR_COLUMNS)))
        neighbours[:, :, :4] = frenet
        for step, vehicle in np.ndindex(*frenet.shape[:2]):
            s, d, along, across = frenet[step, vehicle].tolist()
            x, y, heading = to_cartesian(line, s, d)
            neighbours[step, vehicle, 4:] = x, y, heading + (atan2(across, along) if along > 1.0 else 0.0)
        return neighbours

    def _jerks(self, dynamics: Floats, n: int) -> Floats:
        """Returns longitudinal and lateral jerk over the last `JERK_SECONDS`, after each of n steps, shape (n, 2)."""
        samples = round(self.scenario.step / SAMPLE_TIME)
        ends = np.arange(1, n + 1) * samples - 1
        begins = np.maximum(ends - round(JERK_SECONDS / SAMPLE_TIME), 0)
        seconds = (ends - begins)[:, None] * SAMPLE_TIME
        return np.asarray((dynamics[ends, 1:3] - dynamics[begins, 1:3]) / np.maximum(seconds, SAMPLE_TIME))

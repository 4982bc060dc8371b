"""The time series of one run, for people to look at."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from drivecal.domain.evaluations import RunResult
from drivecal.domain.roads import Floats
from drivecal.domain.scenarios import Scenario
from drivecal.episode.loop import Drive

EGO_COLUMNS = (
    "x_m",
    "y_m",
    "heading_rad",
    "speed_mps",
    "side_slip_rad",
    "yaw_rate_radps",
    "longitudinal_acceleration_mps2",
    "lateral_acceleration_mps2",
)
PLAN_COLUMNS = ("time_s", "x_m", "y_m", "heading_rad", "curvature_1pm", "speed_mps", "acceleration_mps2")
NEIGHBOUR_COLUMNS = ("s_m", "d_m", "s_dot_mps", "d_dot_mps")


@dataclass(frozen=True, slots=True)
class Trace:
    """One run step by step; rows are the moments after each step. SI units.

    `times`: (n,) s. `ego`: (n, 8), `EGO_COLUMNS`. `frenet`: (n, 2), s and d. `plans`: by the time when each was made, (m, 7),
    `PLAN_COLUMNS`. `neighbours`: by vehicle id, (n, 4), `NEIGHBOUR_COLUMNS`.
    """

    scenario: str
    times: Floats
    ego: Floats
    frenet: Floats
    plans: dict[float, Floats]
    neighbours: dict[str, Floats]
    result: RunResult

    def to_json(self) -> dict[str, Any]:
        """Plain data: one list per quantity."""
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
            "plans": [{"made_at_s": time} | _columns(PLAN_COLUMNS, plan) for time, plan in self.plans.items()],
        }


def _columns(names: tuple[str, ...], rows: Floats) -> dict[str, list[float]]:
    return {name: column.tolist() for name, column in zip(names, rows.T, strict=True)}


@dataclass(slots=True)
class Recorder:
    """Notes what happens in a run: the closed loop's `Watcher`."""

    scenario: Scenario
    _poses: list[Floats] = field(default_factory=list)
    _neighbours: list[Floats] = field(default_factory=list)
    _plans: dict[float, Floats] = field(default_factory=dict)

    def __call__(self, index: int, plan: Floats | None, pose: Floats, neighbours: Floats) -> None:
        """After step `index`."""
        self._poses.append(pose.copy())
        self._neighbours.append(neighbours[:, :4].copy())
        if plan is not None:
            self._plans[round(index * self.scenario.step, 9)] = plan.copy()

    def trace(self, drive: Drive, result: RunResult) -> Trace:
        """What was noted. A last step that left the road has no row, because SUMO never saw it."""
        n = len(self._poses)
        neighbours = np.array(self._neighbours).reshape(n, len(self.scenario.traffic), 4)
        return Trace(
            scenario=self.scenario.id,
            times=np.arange(1, n + 1, dtype=np.float64) * self.scenario.step,
            ego=np.array(self._poses).reshape(n, len(EGO_COLUMNS)),
            frenet=drive.motion[1 : n + 1, [0, 3]].copy(),
            plans=self._plans,
            neighbours={vehicle.id: neighbours[:, index] for index, vehicle in enumerate(self.scenario.traffic)},
            result=result,
        )

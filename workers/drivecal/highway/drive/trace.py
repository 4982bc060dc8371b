"""Time series and replay of a run with a task."""

import numpy as np

from drivecal.contracts.evaluation import ReplayPlan, SeriesAnswer
from drivecal.domain.evaluations import RunResult
from drivecal.domain.roads import Floats
from drivecal.domain.scenarios import Scenario
from drivecal.highway.drive.measures import TICK, Record, jerks
from drivecal.highway.drive.replay import DriveRecorder
from drivecal.highway.drive.traffic import Traffic
from drivecal.roads.corridor import Corridor

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
NEIGHBOUR_COLUMNS = ("s_m", "d_m", "s_dot_mps", "d_dot_mps", "x_m", "y_m", "heading_rad")
PLAN_DIGITS = 6


def _columns(names: tuple[str, ...], rows: Floats) -> dict[str, list[float]]:
    return {name: column.tolist() for name, column in zip(names, rows.T, strict=True)}


class TaskRecorder:
    """Records a run as the closed loop's `Watcher`."""

    def __init__(self, scenario: Scenario) -> None:
        """Records one run of a scenario."""
        self._scenario, self._drive = scenario, DriveRecorder(scenario.step)
        self._poses: list[Floats] = []
        self._others: dict[str, list[Floats]] = {vehicle.id: [] for vehicle in scenario.traffic}
        self._plans: list[ReplayPlan] = []

    def __call__(self, traffic: Traffic, pose: Floats, plan: Floats | None) -> None:
        self._drive(traffic, pose, plan)
        if plan is not None:
            made_at = round((len(self._poses) - 1) * self._scenario.step, 9)
            self._plans.append(ReplayPlan(made_at_s=made_at, **_columns(PLAN_COLUMNS, plan.round(PLAN_DIGITS))))
        self._poses.append(pose.copy())
        for name, row in zip(traffic.names, np.hstack([traffic.neighbours[:, :4], traffic.outlines[:, :3]]), strict=True):
            self._others[name].append(row)

    def answer(self, record: Record, result: RunResult, corridor: Corridor) -> SeriesAnswer:
        """Returns the recorded run, with a value after each step. A last step that left the road has none: SUMO never received it."""
        n, step = len(self._poses) - 1, self._scenario.step
        ends = np.arange(1, n + 1) * round(step / TICK) - 1
        series = {"time_s": (np.arange(1, n + 1) * step).tolist()}
        series |= _columns(("s_m", "d_m"), record.motion[1 : n + 1, [0, 3]])
        series |= _columns(EGO_COLUMNS, np.array(self._poses[1:]).reshape(n, len(EGO_COLUMNS)))
        for column, axis in enumerate(("longitudinal", "lateral"), 1):
            series[f"{axis}_jerk_mps3"] = jerks(record.dynamics[:, column])[ends].tolist()
        for name, rows in self._others.items():
            others = _columns(NEIGHBOUR_COLUMNS, np.array(rows[1:]).reshape(-1, len(NEIGHBOUR_COLUMNS)))
            series |= {f"{name}_{quantity}": values for quantity, values in others.items()}
        replay = self._drive.replay(record, self._scenario.ego.length, corridor)
        return SeriesAnswer(
            measures=dict(result.metrics),
            failure=result.failure.value if result.failure else None,
            series=series,
            replay=None if replay is None else replay.model_copy(update={"plans": self._plans}),
        )

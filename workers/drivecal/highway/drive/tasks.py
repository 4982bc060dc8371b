"""Simulation of parameter sets in one scenario with a task, by an installed driving function in the worker itself."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import isfinite
from typing import Any
from weakref import finalize

import numpy as np

from drivecal.adapters.environment import let_go, sessions
from drivecal.adapters.files import remove
from drivecal.bundles.highway import FARTHEST, HighwayScenario, Scenario, TrafficVehicle
from drivecal.cluster.machine import locked_folder
from drivecal.contracts.evaluation import ReplayPlan
from drivecal.domain.evaluations import Failure
from drivecal.domain.roads import Floats
from drivecal.highway.comfort.metrics import comfort_metrics
from drivecal.highway.drive.control import PlannerControl
from drivecal.highway.drive.loop import Loop
from drivecal.highway.drive.measures import TICK, Record, jerks
from drivecal.highway.drive.replay import DriveRecorder
from drivecal.highway.drive.road import HighwayRoad
from drivecal.highway.drive.traffic import Traffic
from drivecal.plugins.ports import DrivingFunction, Series, SeriesEvaluator, VehicleModel
from drivecal.plugins.simulators import RunOutcome
from drivecal.roads.carriageway import corridor_of
from drivecal.roads.corridor import Corridor

NETWORK = "road.net.xml"
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
SHARED = ("id", "lane", "s", "speed", "length", "width", "acceleration", "deceleration", "time_headway")
"""Fields that a vehicle has in a scenario with a task and in others."""


def drawn(scenario: Scenario) -> Scenario:
    """Returns a scenario with the starts and speeds of its other vehicles under its seed. What SUMO draws (`sigma`) is not among them."""
    return replace(scenario, traffic=tuple(_drawn(other, [scenario.seed, row]) for row, other in enumerate(scenario.traffic)))


def _drawn(other: TrafficVehicle, seed: list[int]) -> TrafficVehicle:
    if not other.speed_deviation and not other.departure_deviation:
        return other
    late, fast = np.random.Generator(np.random.PCG64(seed)).standard_normal(2).clip(-FARTHEST, FARTHEST).tolist()
    factor = 1.0 + other.speed_deviation * fast
    s = other.s - other.departure_deviation * late * other.speed
    return other.model_copy(update={"s": s, "speed": factor * other.speed, "desired_speed": factor * other.desired_speed})


def described(scenario: Scenario) -> HighwayScenario:
    """Returns a scenario with a task as one of a problem, without the drifts of its vehicles. Raises ValueError if it cannot be one."""
    lane, ego = scenario.task.start_lane, scenario.ego
    start = {"lane": lane, "s": ego.s, "speed": ego.speed, "offset": ego.d - lane * scenario.road.lane_width}
    others = [
        {name: getattr(other, name) for name in SHARED}
        | {"max_speed": other.desired_speed}
        | ({"model": "Krauss", "sigma": other.sigma} if other.sigma else {})
        for other in scenario.traffic
    ]
    return HighwayScenario.model_validate(
        {
            "network": NETWORK,
            "route": list(scenario.route),
            "duration": scenario.duration,
            "seed": scenario.seed,
            "ego": start | {"length": ego.length, "width": ego.width},
            "traffic": others,
        }
    )


def drift_offsets(vehicle: TrafficVehicle, scenario: Scenario) -> list[float]:
    """Returns the vehicle's offset from its lane's centre (m, to the left) after each step of the scenario."""
    steps = round(scenario.duration / scenario.step)
    return [_interpolate(vehicle.drift, (step + 1) * scenario.step) for step in range(steps)]


def _interpolate(knots: Sequence[tuple[float, float]], time: float) -> float:
    for (begin, first), (end, second) in pairwise(knots):
        if time < end:
            return first + (second - first) * max(0.0, time - begin) / (end - begin) if begin < end else first
    return knots[-1][1]


def road_of(scenario: Scenario) -> HighwayRoad:
    """Returns the road of a scenario's network. Raises InvalidInputError if it cannot be driven."""
    return HighwayRoad(corridor_of(scenario.network, scenario.route, f"{scenario.id}.net.xml"), carriageway=scenario.road)


class TaskRunner:
    """Simulates parameter sets in one scenario, in the only SUMO simulation of this process.

    Runners of several scenarios may coexist; switching between them costs a reload of some milliseconds. Equal parameters give equal bits,
    independent of earlier runs.
    """

    def __init__(
        self,
        scenario: Scenario,
        driving_function: DrivingFunction,
        vehicle: VehicleModel,
        evaluator: SeriesEvaluator | None = None,
    ) -> None:
        """Creates a runner.

        Args:
            scenario: the scenario, with the seed of the first runs.
            driving_function: what drives.
            vehicle: as from `Vehicle.create`; runners must not share it.
            evaluator: rates the runs.

        Raises InvalidInputError if the scenario cannot be driven, TrafficError if SUMO refuses it,
        and UnavailableError if another user could change its files.
        """
        self.parameters = tuple(parameter.name for parameter in next(iter(driving_function.spaces.values())))
        """Names of the driving function's parameters in the order of `run`."""
        self._function, self._vehicle, self._evaluator = driving_function, vehicle, evaluator
        self._folder, lock = locked_folder(sessions(), "drivecal-drive-l-", remove)
        finalize(self, let_go, self._folder, lock)
        (self._folder / NETWORK).write_bytes(scenario.network)
        self._road = road_of(scenario)
        self._prepare(scenario)

    def _prepare(self, scenario: Scenario) -> None:
        """Prepares the runs under the scenario's seed, which other vehicles and the planner may depend on."""
        self._given, self._scenario = scenario, drawn(scenario)
        drifts = {other.id: drift_offsets(other, scenario) for other in scenario.traffic if other.drift}
        vehicles = described(self._scenario)
        traffic = Traffic(scenario.id, vehicles, self._folder / NETWORK, self._road, scenario.step, self._folder, drifts=drifts)
        control = PlannerControl(self._function.create(self._scenario))
        self._loop = Loop(traffic, self._vehicle, control, verge=0.0, heading=scenario.ego.heading)

    def seed(self, number: int) -> None:
        """Sets the seed of the next runs."""
        if number != self._given.seed:
            self._prepare(replace(self._given, seed=number))

    def run(self, parameters: Sequence[Any], *, series: bool = False) -> RunOutcome:
        """Runs one simulation.

        Args:
            parameters: values in the order of the driving function's parameters.
            series: the outcome has time series and a replay.

        Raises TrafficError if SUMO fails, and ValueError if a measure or the rating is not finite.
        """
        recorder = TaskRecorder(self._scenario) if series else None
        finished = self._loop.run(parameters, watch=recorder)
        motion, dynamics = finished.record.motion, finished.record.dynamics
        offsets = target_offsets(motion, self._scenario)
        signals = Series(dynamics, offsets[1:])
        metrics = comfort_metrics(signals.dynamics, signals.offset, self._scenario.step) | {
            "driven_s": (len(motion) - 1) * self._scenario.step,
            "final_offset_m": offsets.item(-1),
            "final_speed_error_mps": speed_errors(motion[-1:], self._scenario).item(),
        }
        metrics |= getattr(self._vehicle, "metrics", None) or {}  # some vehicles have none, some only after a run
        failure, rating = finished.failure, None
        if failure is None and not fulfilled(motion, self._scenario):
            failure = Failure.TASK_MISSED.value
        if failure is None and self._evaluator is not None:
            rating = self._evaluator.rate_series(self._scenario.rated_as, signals)
        outcome = RunOutcome({name: float(value) for name, value in metrics.items()}, failure, rating=rating)
        numbers = {**outcome.measures, **({} if rating is None else {"rating": rating.rating, "score": rating.score})}
        if wrong := [f"{name} is {value}" for name, value in numbers.items() if not isfinite(value)]:
            raise ValueError(f"{' and '.join(wrong)}; results must be finite")
        return outcome if recorder is None else recorder.completed(outcome, finished.record, self._road.corridor)


def target_offsets(motion: Floats, scenario: Scenario) -> Floats:
    """Returns the offsets (m, to the left) from the target lane's centre, shape (n,), of Frenet motions of shape (n, 6)."""
    offsets: Floats = motion[:, 3] - scenario.task.target_lane * scenario.road.lane_width
    return offsets


def speed_errors(motion: Floats, scenario: Scenario) -> Floats:
    """Returns the speed along the road minus the desired speed (m/s), shape (n,), of Frenet motions of shape (n, 6)."""
    knots, speeds = np.array(scenario.task.speeds).T
    current = np.maximum(np.searchsorted(knots, motion[:, 0], side="right") - 1, 0)
    errors: Floats = motion[:, 1] - speeds[current]
    return errors


def fulfilled(motion: Floats, scenario: Scenario) -> bool:
    """Returns True if the whole scenario was driven and the task's tolerances held during its last `hold` seconds.

    `motion`: the Frenet motion at the start and after each step, shape (n + 1, 6).
    """
    task = scenario.task
    steps = round(scenario.duration / scenario.step)
    if len(motion) != steps + 1:
        return False
    end = motion[-round(task.hold / scenario.step) - 1 :]
    in_lane = np.abs(target_offsets(end, scenario)).max() <= task.lane_tolerance
    at_speed = np.abs(speed_errors(end, scenario)).max() <= task.speed_tolerance
    return bool(in_lane and at_speed)


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

    def completed(self, outcome: RunOutcome, record: Record, corridor: Corridor) -> RunOutcome:
        """Returns the outcome with the record: a value after each step. A last step that left the road has none: SUMO never got it."""
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
        replay = None if replay is None else replay.model_copy(update={"plans": self._plans})
        return replace(outcome, series=series, replay=replay)

"""Simulation and rating of parameter sets in one scenario, and the check of its task."""

from collections.abc import Mapping, Sequence

import numpy as np

from drivecal.domain.evaluations import FAILED_RATING, Failure, Rating, RunResult
from drivecal.domain.roads import Floats
from drivecal.domain.scenarios import Scenario
from drivecal.highway.comfort.metrics import comfort_metrics
from drivecal.highway.episode.loop import ClosedLoop, Drive
from drivecal.highway.episode.trace import Recorder, Trace
from drivecal.highway.traffic.simulation import simulation
from drivecal.plugins.ports import DrivingFunction, Evaluator, Series, SeriesEvaluator, VehicleModel


class EpisodeRunner:
    """Simulates and rates parameter sets in one scenario, in the only SUMO simulation of this process.

    Runners of several scenarios may coexist; switching between them costs a reload of some milliseconds. Equal parameters give equal bits,
    independent of earlier runs.
    """

    def __init__(
        self, scenario: Scenario, driving_function: DrivingFunction, vehicle: VehicleModel, evaluator: Evaluator
    ) -> None:
        """Creates a runner. `vehicle`: as from `Vehicle.create`; runners must not share it."""
        self.parameters = tuple(parameter.name for parameter in next(iter(driving_function.spaces.values())))
        """Names of the driving function's parameters in the order of `run`."""
        self._scenario = scenario
        self._evaluator = evaluator
        self._series_evaluator = evaluator if isinstance(evaluator, SeriesEvaluator) else None  # isinstance takes microseconds
        self._vehicle = vehicle
        self._loop = ClosedLoop(scenario, driving_function.create(scenario), vehicle, simulation())

    def run(self, parameters: Sequence[float]) -> RunResult:
        """Runs one simulation with these parameter values, in the order of the driving function's parameters.

        Raises SimulationError if SUMO fails, which is not a result, unlike a `failure` of the driving function.
        """
        return self._result(self._loop.drive(parameters))

    def trace(self, parameters: Sequence[float]) -> Trace:
        """Runs the same simulation and returns its time series, too."""
        recorder = Recorder(self._scenario)
        drive = self._loop.drive(parameters, recorder)
        return recorder.trace(drive, self._result(drive))

    def _result(self, drive: Drive) -> RunResult:
        offsets = target_offsets(drive.motion, self._scenario)
        series = Series(drive.dynamics, offsets[1:])
        metrics = comfort_metrics(series.dynamics, series.offset) | {
            "driven_s": (len(drive.motion) - 1) * self._scenario.step,
            "final_offset_m": offsets.item(-1),
            "final_speed_error_mps": speed_errors(drive.motion[-1:], self._scenario).item(),
        }
        measured = getattr(self._vehicle, "metrics", None)  # `SelfMeasuring`, in some vehicles only after a run
        if measured is not None:
            metrics |= measured
        failure = drive.failure
        if failure is None and not fulfilled(drive.motion, self._scenario):
            failure = Failure.TASK_MISSED
        return RunResult(FAILED_RATING if failure else self._rating(metrics, series), metrics, failure)

    def _rating(self, metrics: Mapping[str, float], series: Series) -> Rating:
        if self._series_evaluator is not None:
            return self._series_evaluator.rate_series(self._scenario.rated_as, series)
        return self._evaluator.rate(self._scenario.rated_as, metrics)


def target_offsets(motion: Floats, scenario: Scenario) -> Floats:
    """Returns the offsets (m, to the left) from the target lane's centre, shape (n,), of Frenet motions of shape (n, 6)."""
    offsets: Floats = motion[:, 3] - scenario.task.target_lane * scenario.road.lane_width
    return offsets


def speed_errors(motion: Floats, scenario: Scenario) -> Floats:
    """Returns the speed along the road minus the desired speed (m/s), shape (n,), of Frenet motions of shape (n, 6)."""
    knots = np.array([knot.s for knot in scenario.task.speeds])
    speeds = np.array([knot.speed for knot in scenario.task.speeds])
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

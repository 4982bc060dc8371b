"""Models of the single-track and the hybrid vehicle."""

from collections.abc import Mapping

import numpy as np

from drivecal.highway.vehicle import kernels, single_track
from drivecal.highway.vehicle.parameters import NOMINAL, SingleTrackParameters
from drivecal.highway.vehicle.residual import Residual
from drivecal.plugins.ports import Floats


class SingleTrackModel:
    """A vehicle that follows trajectories (port `VehicleModel`) or commands. Its controller is that of the `nominal` vehicle."""

    def __init__(self, parameters: SingleTrackParameters, nominal: SingleTrackParameters = NOMINAL) -> None:
        self.parameters = parameters
        self._plant = single_track.pack_plant(parameters)
        self._controller = kernels.pack_controller(nominal)
        self._state = np.zeros(9)
        self._pose = self._state[:8]

    def start(self, x: float, y: float, heading: float, speed: float) -> None:
        """Starts a new run straight ahead, without acceleration. Centre of mass in m, heading in rad, speed in m/s."""
        self._state[:] = 0.0
        self._state[:4] = (x, y, heading, speed)

    @property
    def pose(self) -> Floats:
        """(x, y, heading, speed, side slip angle, yaw rate, accelerations along and across the course), shape (8,), SI.

        A live view that changes with the vehicle; copy it to keep it. The course over ground is heading plus side-slip angle.
        """
        return self._pose

    @property
    def arrays(self) -> tuple[Floats, Floats, Floats]:
        """State, plant and controller, the first arguments of `kernels.drive`. The state changes with the vehicle."""
        return self._state, self._plant, self._controller

    def follow(self, trajectory: Floats, since: float, duration: float, dynamics: Floats) -> bool:
        """Tracks `trajectory` from `since` seconds after its start for `duration` seconds; see `ports.VehicleModel.follow`.

        Returns False if the vehicle became unstable: its state and the remaining rows keep their last valid values. Raises ValueError if
        the trajectory ends before `since` + `duration`, or if `dynamics` does not have one row per 0.01 s.
        """
        steps = round(duration / single_track.STEP)
        if dynamics.shape[0] != steps:
            raise ValueError(f"dynamics has {dynamics.shape[0]} rows; {duration} s need {steps}")
        status = kernels.drive(*self.arrays, kernels.TRAJECTORY, 0.0, 0.0, trajectory, since, steps, dynamics)
        if status == kernels.TOO_SHORT:
            raise ValueError(f"the trajectory does not cover {since} s to {since + duration} s after its start")
        return bool(status == kernels.FOLLOWED)


class HybridModel(SingleTrackModel):
    """The single-track vehicle with a neural residual, which is the same for all `parameters`.

    Outside the training range of the residual, it equals the single-track vehicle.
    """

    def __init__(self, parameters: SingleTrackParameters, residual: Residual) -> None:
        super().__init__(parameters)
        self._plant = np.concatenate([self._plant, residual.pack(parameters)])
        self._state = np.zeros(10)
        self._pose = self._state[:8]

    @property
    def metrics(self) -> Mapping[str, float]:
        """Seconds of the run outside the residual's training range, where the vehicle fell back to the single track."""
        return {"outside_training_range_s": self._state.item(9) * single_track.STEP}

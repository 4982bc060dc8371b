"""Controls of the ego vehicle, by controllers of users and by planners, and its view of a run."""

from typing import Any

import numpy as np

from drivecal.domain.roads import Floats
from drivecal.highway.drive import geometry
from drivecal.highway.drive.controllers import Checked
from drivecal.highway.drive.geometry import keeper_acceleration
from drivecal.highway.drive.road import HighwayRoad
from drivecal.highway.drive.traffic import Traffic
from drivecal.highway.vehicle import kernels
from drivecal.plugins.ports import Observation, Planner


class RunView(Observation):
    """The ego vehicle and its surroundings at an instant. The loop changes it; all arrays are live, as in `geometry`.

    `lead`: seconds since the other vehicles were read.
    """

    def __init__(self, road: HighwayRoad, traffic: Traffic, pose: Floats, motion: Floats) -> None:
        """Shows a run on a road."""
        super().__init__(0.0, motion[geometry.FRENET : geometry.FRENET + 6], traffic.neighbours)
        self.road, self.traffic, self.pose, self.motion, self.lead = road, traffic, pose, motion, 0.0
        self._signals = np.zeros(geometry.SIGNALS)

    def signals(self) -> list[float]:
        """Returns what controllers observe, in the order of `geometry.NAMES`."""
        road, outlines = self.road, self.traffic.outlines
        geometry.observe(
            road.line, road.lanes, road.ends, self.neighbours, outlines, self.motion, self.pose, self.time, self.lead,
            self._signals,
        )  # fmt: skip
        values: list[float] = self._signals.tolist()
        return values


Command = tuple[Floats | None, float, float]
"""A trajectory (n, 7) that begins now, or commands: steering angle or curvature, and acceleration."""


class CommandControl:
    """A controller of a user's that steers and accelerates. What it leaves out, the lane keeper and the speed keeper do."""

    def __init__(self, controller: Checked, period: float) -> None:
        self.period, self._controller, output = period, controller, controller.output
        lateral = next((index for index, name in enumerate(output) if name != "acceleration"), None)
        self._lateral, self._acceleration = lateral, output.index("acceleration") if "acceleration" in output else None
        self.by = kernels.PATH if lateral is None else {"curvature": kernels.CURVATURE}.get(output[lateral], kernels.STEERING)

    def begin(self, parameters: Any) -> None:
        """Starts a run."""
        self._controller.begin(parameters)

    def act(self, view: RunView) -> Command:
        """Returns the command that holds for a period."""
        signals = view.signals()
        commands = self._controller.step(signals)
        lateral = 0.0 if self._lateral is None else float(commands[self._lateral])
        wanted = self._acceleration
        return None, lateral, keeper_acceleration(signals) if wanted is None else float(commands[wanted])


class PlannerControl:
    """A driving function's planner."""

    by = kernels.TRAJECTORY

    def __init__(self, planner: Planner) -> None:
        """Lets `planner` drive, whose parameters are values in the driving function's order."""
        self.period, self._planner, self._plan = planner.period, planner, planner.plan

    def begin(self, parameters: Any) -> None:
        """Starts a run."""
        self._planner.reset(parameters)

    def act(self, view: RunView) -> Command:
        """Returns the command that holds for a period."""
        return self._plan(view), 0.0, 0.0


EgoControl = CommandControl | PlannerControl
"""A control of the ego vehicle. `period` is in seconds between two commands; `by` says how it steers, as in `kernels.drive`."""

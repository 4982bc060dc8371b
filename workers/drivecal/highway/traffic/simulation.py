"""The SUMO simulation of a process, which removes and re-adds all vehicles between runs.

libsumo keeps the simulation in global state, so that every process has exactly one `Simulation`, returned by `simulation()`. A reset is
bit-identical to a fresh start, because the simulation has no randomness (see `configuration.EXACT`) and does not depend on the clock.
"""

import tempfile
from collections.abc import Sequence
from functools import cache
from math import hypot
from pathlib import Path
from typing import Any

import numpy as np

from drivecal.domain.errors import DrivecalError, InvalidInputError
from drivecal.domain.roads import Floats, reference_line, to_cartesian
from drivecal.domain.scenarios import Scenario
from drivecal.highway import sumo
from drivecal.highway.geometry import with_directions
from drivecal.highway.sumo import (
    EGO,
    MAPPED_ANYWHERE,
    MAPPED_WITHIN,
    MOVE_TO_XY,
    STEP,
    SUMO_ERRORS,
)
from drivecal.highway.traffic.configuration import ROUTE, drift_offsets, routes
from drivecal.highway.traffic.geometry import locate, settle

PLACE_TOLERANCE = 0.5
"""Largest distance (m) between the start of a vehicle and the nearest position on a lane."""


class SimulationError(DrivecalError):
    """SUMO failed; the message quotes SUMO."""


class Simulation:
    """SUMO with one scenario loaded. Create it by `simulation()` only.

    `neighbours`: (s, d, s', d', length, width) of the other vehicles' centres in the order of the scenario's traffic, shape (n, 6).
    `outlines`: their (x, y, heading, half length, half width), shape (n, 5). Both are overwritten by `reset` and `advance`.
    """

    def __init__(self) -> None:
        self._scenario: Scenario | None = None
        self._load = 0
        self._step = 0.0
        self._line: Floats = np.zeros((0, 7))
        self._starts: list[sumo.Start] = []
        self._drifts: list[tuple[int, str, list[float]]] = []
        """Row, id and offsets from the lane's centre (m) after each step, of all drifting vehicles."""
        self._start: Floats = np.zeros((0, 6))
        self._names: list[str] = []
        self._lanes: list[float] = []
        self._raw: Floats = np.zeros((0, 4))
        self._ego: Floats = np.zeros(2)
        """Half length and half width of the ego vehicle."""
        self._cells: Any = self._raw.reshape(-1).data
        """Memoryview of `_raw`."""
        self.neighbours: Floats = np.zeros((0, 6))
        self.outlines: Floats = np.zeros((0, 5))

    def load(self, scenario: Scenario) -> None:
        """Loads `scenario` unless it is loaded already. Raises SimulationError if SUMO rejects it."""
        if scenario is self._scenario and sumo.is_current(self._load):
            return
        self._scenario = None
        with tempfile.TemporaryDirectory() as folder:
            network, route_file = Path(folder) / "road.net.xml", Path(folder) / "road.rou.xml"
            network.write_bytes(scenario.network)
            try:
                route_file.write_bytes(routes(scenario))
            except InvalidInputError as error:
                raise SimulationError(f"scenario {scenario.id}: {error}") from error
            try:
                self._load = sumo.load(sumo.options(str(network), str(route_file), scenario.step, scenario.seed))
            except SUMO_ERRORS as error:
                raise SimulationError(f"SUMO cannot load scenario {scenario.id}: {error}") from error
        width, ego, traffic = scenario.road.lane_width, scenario.ego, scenario.traffic
        self._step = scenario.step
        self._ego = np.array([0.5 * ego.length, 0.5 * ego.width])
        line = reference_line(scenario.road)
        self._line = with_directions(line)
        drifting = [(row, vehicle) for row, vehicle in enumerate(traffic) if vehicle.drift]
        self._drifts = [(row, vehicle.id, drift_offsets(vehicle, scenario)) for row, vehicle in drifting]
        fronts = [(vehicle.id, vehicle.s + 0.5 * vehicle.length, vehicle.lane * width, vehicle.speed) for vehicle in traffic]
        fronts.append((EGO, ego.s + 0.5 * ego.length, scenario.task.start_lane * width, ego.speed))
        try:
            self._starts = [sumo.Start(name, ROUTE, *_lane_at(line, name, s, d), speed) for name, s, d, speed in fronts]
        except SUMO_ERRORS as error:
            raise SimulationError(f"the network of scenario {scenario.id} does not hold its vehicles: {error}") from error
        rows = [(vehicle.s, vehicle.lane * width, 0.0, 0.0, vehicle.length, vehicle.width) for vehicle in traffic]
        self._start = np.array(rows, dtype=np.float64).reshape(-1, 6)
        self._names = [vehicle.id for vehicle in traffic]
        self._lanes = self._start[:, 1].tolist()
        self._raw = np.zeros((len(rows), sumo.COLUMNS))
        self._raw[:, 3] = self._lanes  # only the ego vehicle changes lane: `reset` disables it for others
        self._cells = self._raw.reshape(-1).data
        self.neighbours = self._start.copy()
        self.outlines = np.zeros((len(rows), 5))
        self._scenario = scenario

    def reset(self) -> None:
        """Removes all vehicles and adds them at their starts.

        Raises SimulationError if a vehicle is missing afterwards, which SUMO does not report. The next `load` then reloads the scenario.
        """
        try:
            sumo.clear()
            missing = sumo.place(self._starts)
            for name in self._names:
                if name not in missing:
                    sumo.vehicle.setLaneChangeMode(name, sumo.NO_LANE_CHANGES)
        except SUMO_ERRORS as error:
            self._scenario = None
            raise SimulationError(f"SUMO cannot place the vehicles: {error}") from error
        if missing:
            self._scenario = None
            raise SimulationError(f"SUMO did not accept the vehicles {', '.join(missing)}; place them farther apart")
        self.neighbours[:] = self._start
        self._read()
        locate(self._line, self._raw, self.neighbours, self.outlines, 0.0)

    def advance(self, index: int, front: Sequence[float], pose: Floats) -> bool:
        """Simulates step number `index` of the run; returns whether the ego vehicle has hit another vehicle.

        `pose`: the ego vehicle at the end of the step; `front`: as from `geometry.place`, on the road, which SUMO does not
        check. Raises SimulationError if a vehicle is lost; the next `load` then reloads the scenario.
        """
        try:
            for _, name, offsets in self._drifts:
                sumo.vehicle.setLateralLanePosition(name, offsets[index])
            MOVE_TO_XY(EGO, "", -1, front[0], front[1], front[2], MAPPED_ANYWHERE, MAPPED_WITHIN)
            STEP()
            self._read()
        except SUMO_ERRORS as error:
            self._scenario = None
            raise SimulationError(f"SUMO lost a vehicle at step {index}: {error}") from error
        return settle(self._line, self._raw, self.neighbours, self.outlines, self._step, pose, self._ego)

    def _read(self) -> None:
        sumo.read(self._names, self._cells)
        for row, name, _ in self._drifts:
            self._cells[sumo.COLUMNS * row + 3] = self._lanes[row] + sumo.vehicle.getLateralLanePosition(name)


def _lane_at(line: Floats, name: str, s: float, d: float) -> tuple[str, float]:
    """Returns SUMO's lane and the position along it, which differs from the arc length on curved edges."""
    x, y, _ = to_cartesian(line, s, d)
    edge, position, lane = sumo.simulation.convertRoad(x, y)
    mapped_x, mapped_y = sumo.simulation.convert2D(edge, position, lane)
    if hypot(mapped_x - x, mapped_y - y) > PLACE_TOLERANCE:
        raise SimulationError(f"the network has no lane for vehicle {name} at s = {s} m, d = {d} m; place it on the road")
    return f"{edge}_{lane}", position


@cache
def simulation() -> Simulation:
    """Returns the simulation of this process."""
    return Simulation()

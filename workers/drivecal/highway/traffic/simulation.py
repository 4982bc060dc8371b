"""The SUMO simulation of a process, which removes and re-adds all vehicles between runs.

libsumo keeps the simulation in global state, so that every process has exactly one `Simulation`, returned by `simulation()`. A reset is
bit-identical to a fresh start, because the simulation has no randomness (see `EXACT`) and does not depend on the clock.

SUMO knows vehicles by lane and position. The ego vehicle is moved along its lane by the speed that leads there, and put into another lane
by name. Of the others it is asked for their speeds only: their places follow from them, and their drifts are the scenario's.
"""

import tempfile
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from drivecal.domain.errors import DrivecalError, InvalidInputError
from drivecal.domain.roads import Floats
from drivecal.domain.scenarios import Scenario, TrafficVehicle
from drivecal.highway import sumo
from drivecal.highway.geometry import with_directions
from drivecal.highway.sumo import EGO, SET_SPEED, STEP, SUMO_ERRORS
from drivecal.highway.traffic.geometry import LANE, OFFSET, PLACE, SPEED, locate, settle
from drivecal.highway.traffic.lanes import SumoLanes
from drivecal.roads.carriageway import carriageway, corridor_of

ROUTE = "road"


def routes(scenario: Scenario) -> bytes:
    """Returns the route file: one route over the whole road, one vehicle type per vehicle, no vehicles (each run adds them)."""
    root = Element("routes")
    SubElement(root, "route", id=ROUTE, edges=" ".join(scenario.route))
    for vehicle in scenario.traffic:
        SubElement(root, "vType", _type(vehicle))
    SubElement(root, "vType", {"id": EGO, "length": repr(scenario.ego.length), "width": repr(scenario.ego.width), **EXACT})
    return tostring(root)


EXACT = {"carFollowModel": "IDM", "speedFactor": "1", "speedDev": "0"}
"""Parameters of the intelligent driver model (Treiber et al. 2000) without randomness."""


def _type(vehicle: TrafficVehicle) -> dict[str, str]:
    values = {
        "length": vehicle.length,
        "width": vehicle.width,
        "accel": vehicle.acceleration,
        "decel": vehicle.deceleration,
        "tau": vehicle.time_headway,
        "maxSpeed": vehicle.desired_speed,
    }
    return {"id": vehicle.id, **EXACT, **{name: repr(value) for name, value in values.items()}}


def drift_offsets(vehicle: TrafficVehicle, scenario: Scenario) -> list[float]:
    """Returns the vehicle's offset from its lane's centre (m, to the left) after each step of the scenario."""
    steps = round(scenario.duration / scenario.step)
    return [_interpolate(vehicle.drift, (step + 1) * scenario.step) for step in range(steps)]


def _interpolate(knots: tuple[tuple[float, float], ...], time: float) -> float:
    for (begin, first), (end, second) in pairwise(knots):
        if time < end:
            return first + (second - first) * max(0.0, time - begin) / (end - begin)
    return knots[-1][1]


class SimulationError(DrivecalError):
    """SUMO failed; the message quotes SUMO."""


class Simulation:
    """SUMO with one scenario loaded. Create it by `simulation()` only.

    `line`, `along`, `ego`, `neighbours`, `outlines`: as in `geometry`, the others in the order of the scenario's traffic. `reset` and
    `advance` overwrite the last two; `reset` puts `ego` to its start, and `advance` reads it.
    """

    def __init__(self) -> None:
        self._scenario: Scenario | None = None
        self._load = 0
        self._step = 0.0
        self._lanes: SumoLanes
        self._starts: list[sumo.Start] = []
        self._drifts: list[tuple[int, list[float]]] = []
        """Row and d after each step, of all drifting vehicles."""
        self._start, self._start_cells, self._start_ego = np.zeros((0, 6)), np.zeros((4, 0)), np.zeros(4)
        self._size: Floats = np.zeros(2)
        """Half length and half width of the ego vehicle."""
        self._names: list[str] = []
        self._cells: Floats = self._start_cells
        self._speeds: Any = self._cells[SPEED].data
        self._offsets: Any = self._cells[OFFSET].data
        """Memoryviews of rows of `_cells`, to which Python assigns several times faster."""
        self.line: Floats = np.zeros((0, 7))
        self.along: Floats = np.zeros((0, 0))
        self.ego: Floats = np.zeros(4)
        self.neighbours: Floats = np.zeros((0, 6))
        self.outlines: Floats = np.zeros((0, 5))

    def load(self, scenario: Scenario) -> None:
        """Loads `scenario` unless it is loaded already. Raises SimulationError if its network cannot be used, or SUMO rejects it."""
        if scenario is self._scenario and sumo.is_current(self._load):
            return
        self._scenario = None
        lanes = self._measure(scenario)
        with tempfile.TemporaryDirectory() as folder:
            network, route_file = Path(folder) / "road.net.xml", Path(folder) / "road.rou.xml"
            network.write_bytes(scenario.network)
            route_file.write_bytes(routes(scenario))
            try:
                self._load = sumo.load(sumo.options(str(network), str(route_file), scenario.step, scenario.seed))
                sumo.forbid_lane_changes()
            except SUMO_ERRORS as error:
                raise SimulationError(f"SUMO cannot load scenario {scenario.id}: {error}") from error
        width, ego, traffic = scenario.road.lane_width, scenario.ego, scenario.traffic
        self._lanes, self._step = lanes, scenario.step
        self._size = np.array([0.5 * ego.length, 0.5 * ego.width])
        fronts = [(vehicle.id, vehicle.lane, vehicle.s + 0.5 * vehicle.length, vehicle.speed) for vehicle in traffic]
        fronts.append((EGO, scenario.task.start_lane, ego.s + 0.5 * ego.length, ego.speed))
        places = [self._place(scenario, lanes, name, lane, s) for name, lane, s, _ in fronts]
        self._starts = []
        for (name, lane, _, speed), total in zip(fronts, places, strict=True):
            edge, index, position = lanes.place(lane, total)
            self._starts.append(sumo.Start(name, ROUTE, f"{edge}_{index}", position, speed))
        self._start_ego = np.array([scenario.task.start_lane, places[-1], ego.speed, 0.0])
        rows = [(vehicle.s, vehicle.lane * width, 0.0, 0.0, vehicle.length, vehicle.width) for vehicle in traffic]
        self._start = np.array(rows, dtype=np.float64).reshape(-1, 6)
        self._start_cells = np.zeros((4, len(rows)))
        self._start_cells[SPEED] = [vehicle.speed for vehicle in traffic]
        self._start_cells[OFFSET] = self._start[:, 1]
        self._start_cells[LANE] = [vehicle.lane for vehicle in traffic]  # no other vehicle changes lane: `load` forbids it
        self._start_cells[PLACE] = places[:-1]
        self._drifts = [
            (row, [vehicle.lane * width + offset for offset in drift_offsets(vehicle, scenario)])
            for row, vehicle in enumerate(traffic)
            if vehicle.drift
        ]
        self._names = [vehicle.id for vehicle in traffic]
        self._cells = self._start_cells.copy()
        self._speeds, self._offsets = self._cells[SPEED].data, self._cells[OFFSET].data
        self.neighbours = self._start.copy()
        self.outlines = np.zeros((len(rows), 5))
        self._scenario = scenario

    def _measure(self, scenario: Scenario) -> SumoLanes:
        """Returns the lanes of the scenario's road. Raises SimulationError if its network has another road."""
        name = f"{scenario.id}.net.xml"
        try:
            road = carriageway(scenario.network, scenario.route, name)
        except InvalidInputError as error:
            raise SimulationError(f"scenario {scenario.id}: {error}") from error
        if road is not scenario.road and not (
            np.array_equal(road.line, scenario.road.line)
            and (road.lanes, road.lane_width) == (scenario.road.lanes, scenario.road.lane_width)
        ):
            raise SimulationError(f"scenario {scenario.id}: its road is not that of its network; measure it by `carriageway`")
        lanes = SumoLanes(corridor_of(scenario.network, scenario.route, name), road.line[:, 0], joined=True)
        self.line, self.along = with_directions(road.line), np.ascontiguousarray(lanes.totals)
        return lanes

    def _place(self, scenario: Scenario, lanes: SumoLanes, name: str, lane: int, s: float) -> float:
        if not (0 <= lane < scenario.road.lanes and 0.0 <= s <= scenario.road.length):
            raise SimulationError(f"scenario {scenario.id}: vehicle {name} starts off the road; move it into a lane")
        return lanes.total(self.line[:, 0], lane, s)

    def reset(self) -> None:
        """Removes all vehicles and adds them at their starts.

        Raises SimulationError if a vehicle is missing afterwards, which SUMO does not report. The next `load` then reloads the scenario.
        """
        try:
            sumo.clear()
            missing = sumo.place(self._starts)
        except SUMO_ERRORS as error:
            self._scenario = None
            raise SimulationError(f"SUMO cannot place the vehicles: {error}") from error
        if missing:
            self._scenario = None
            raise SimulationError(f"SUMO did not accept the vehicles {', '.join(missing)}; place them farther apart")
        self.ego[:] = self._start_ego
        self.neighbours[:] = self._start
        self._cells[:] = self._start_cells
        locate(self.line, self.along, self._cells, self.neighbours, self.outlines, 0.0)

    def advance(self, index: int, pose: Floats) -> bool:
        """Simulates step number `index` of the run; returns whether the ego vehicle has hit another vehicle.

        `pose`: the ego vehicle at the end of the step, on the road, as `ego`. Raises SimulationError if a vehicle is lost; the next `load`
        then reloads the scenario.
        """
        try:
            lane, place, speed, changed = self.ego.tolist()
            if changed:
                edge, number, position = self._lanes.place(int(lane), place - speed * self._step)
                sumo.vehicle.moveTo(EGO, f"{edge}_{number}", position)
            SET_SPEED(EGO, speed)
            STEP()
            self._speeds[:] = sumo.speeds(self._names)
        except SUMO_ERRORS as error:
            self._scenario = None
            raise SimulationError(f"SUMO lost a vehicle at step {index}: {error}") from error
        for row, offsets in self._drifts:
            self._offsets[row] = offsets[index]
        return settle(self.line, self.along, self._cells, self.neighbours, self.outlines, self._step, pose, self._size)


@cache
def simulation() -> Simulation:
    """Returns the simulation of this process, without a scenario at first."""
    return Simulation()

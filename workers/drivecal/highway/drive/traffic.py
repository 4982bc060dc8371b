"""SUMO's vehicles on a network, and the ego vehicle among them, whose position is set in each step.

libsumo keeps the simulation in global state: if a process has several `Traffic` objects, each loads its network again before it runs. Runs
repeat to the bit: vehicles are removed and added again between runs if nothing is random; else SUMO loads everything again, with the same
seed, and simulates the warm-up.

SUMO knows vehicles by lane and position. If all keep to their lanes, it is asked for their speeds only: their places follow from them.
"""

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import cos, radians, sin
from pathlib import Path

import numpy as np

from drivecal.bundles.highway import Ego, HighwayScenario, Placed
from drivecal.bundles.traffic.route_files import RouteTraffic
from drivecal.domain.errors import DrivecalError, InvalidInputError, Problem, restated
from drivecal.domain.roads import Floats
from drivecal.highway import sumo
from drivecal.highway.drive import geometry
from drivecal.highway.drive.actions import Actions, Moving, PathVehicle
from drivecal.highway.drive.road import HighwayRoad
from drivecal.highway.drive.routes import entries, is_exact, keeps_lanes, options, route_id, routes_file, too_close
from drivecal.highway.geometry import point
from drivecal.highway.sumo import (
    ARRIVED,
    DEPARTED,
    EGO,
    FREE,
    GET_ANGLE,
    GET_LANE_POSITION,
    GET_POSITION,
    GET_ROAD,
    GET_SPEED,
    MAPPED_ANYWHERE,
    MAPPED_WITHIN,
    MOVE_TO_XY,
    NO_LANE_CHANGES,
    SET_SPEED,
    STEP,
    SUMO_ERRORS,
)

CHECKED_STEPS = 50
"""Number of steps after which the ego vehicle is put into its lane again, whatever SUMO has made of its speeds."""
SPLITTING = str.maketrans(",$", "__")
"""Characters of a path that SUMO takes for a list of files and for variables of the environment."""
LARGEST_BEYOND = 0.1
"""Largest distance (m) of a start behind the vehicle's place, so that its front is on a lane."""


class TrafficError(DrivecalError):
    """SUMO refused a network, a route or a vehicle; the message quotes SUMO."""


Drifts = Mapping[str, Sequence[float]]
"""Offsets (m) of vehicles from their lanes' centres after each step of a run."""


class Traffic:
    """The other vehicles of a scenario. Arrays as in `geometry`; they are replaced when vehicles enter or leave.

    `names`: ids of the other vehicles, in the order of the rows of `neighbours` and `outlines`.
    """

    def __init__(
        self,
        name: str,
        scenario: HighwayScenario,
        network: Path,
        road: HighwayRoad,
        step: float,
        folder: Path,
        routes: RouteTraffic | None = None,
        drifts: Drifts | None = None,
    ) -> None:
        """Starts SUMO.

        Args:
            name: The scenario's.
            scenario: With its own vehicles.
            network: SUMO's file.
            road: The road of the drive.
            step: Seconds of a step.
            folder: Where SUMO's route files are written.
            routes: The traffic of the scenario's route file.
            drifts: By the name of the scenario's own vehicles, which keep their lanes in SUMO; None if it has no task.

        Raises:
            TrafficError: SUMO refuses the network or the traffic.
            InvalidInputError: A vehicle's place is not on the road.
        """
        self.name, self.scenario, self.road, self.step = name, scenario, road, step
        vehicles = entries(scenario)
        self._paths = {name: PathVehicle(vehicle) for name, vehicle in vehicles.items() if vehicle.path is not None}
        """Vehicles that SUMO does not know; their rows are the last."""
        self._vehicles = [name for name in vehicles if name not in self._paths]
        self.starting = len(vehicles)
        """Number of the first rows, whose vehicles exist from time 0; the others have come in the warm-up."""
        self._entries = vehicles
        self._routes, self._said = routes, str if routes is None else routes.located
        field = f"scenarios.{name}"
        ego = scenario.ego
        self.start_s, start_d = _centre(road, ego, f"{field}.ego")
        self.start_d = start_d + ego.offset
        self._strays: dict[str, bool] = {}
        """True for vehicles that also drive on edges off the scenario's route, e.g. against it."""
        self._own = frozenset(scenario.route)
        contents = [("traffic.rou.xml", routes_file(scenario, routes))]
        if routes is not None:
            contents.append((f"routes-{Path(scenario.routes or '').name.translate(SPLITTING)}", routes.content))
        for route_file, content in contents:
            (folder / route_file).unlink(missing_ok=True)
            # an earlier child may have left a link to a file that this process may change
            with (folder / route_file).open("xb") as file:
                file.write(content)
        paths = ",".join(str(folder / route_file) for route_file, _ in contents)
        self._options = options(scenario, str(network), paths, step, routes)
        self._is_exact = is_exact(scenario)
        self.keeps_lanes = road.corridor.parallel and keeps_lanes(scenario, with_tasks=drifts is not None)
        """No vehicle leaves its track: SUMO is asked for speeds only."""
        self._steps_before = round(scenario.warm_up / step) if routes is not None else 0
        """Steps of the warm-up."""
        try:
            self._load()
            placed: list[tuple[str, str, Placed, float]] = [
                (f"traffic[{index}]", key, vehicle, vehicle.length)
                for index, (key, vehicle) in enumerate(vehicles.items())
                if key not in self._paths
            ]
            self._starts = [
                sumo.Start(key, route_id(key), *_front(road, entry, length, f"{field}.{part}"), entry.speed, entry.offset)
                for part, key, entry, length in placed
            ]
            self._starts.append(sumo.Start(EGO, route_id(EGO), *_front(road, ego, ego.length, f"{field}.ego"), ego.speed))
        except SUMO_ERRORS as error:
            files = f"the network {scenario.network} with {scenario.routes or 'its traffic'}"
            raise TrafficError(f"{field}: SUMO cannot load {files}: {self._said(error)}") from error
        self._actions = Actions(vehicles, road.lateral, road.stretch, self._paths)
        self._has_actions = self._actions.pending
        curvature = point(road.line, self.start_s)[3]
        start = Moving(self.start_s, self.start_d, ego.speed, 0.5 * ego.length)
        self._ego = self._ego_start = start, 1.0 - curvature * self.start_d
        """The ego vehicle when the others were read, and metres of its way per metre of s."""
        self._track, self._placed, self._border = -1, 0.0, 0.0
        """The track on which SUMO has the ego vehicle, -1 if it is not known, how far along it is and where its lane ends (m, as SUMO
        counts)."""
        self.motion: Floats = np.zeros(geometry.MOTION)
        """The ego vehicle's place, as in `geometry`: `advance` takes SUMO's there."""
        self._at = self.motion.data
        self._drifts = drifts or {}
        self._began: tuple[Floats, Floats] | None = None
        """The arrays at the start of runs that all start alike."""
        self._use([], np.zeros((0, 6)), np.zeros((0, geometry.OUTLINED)))

    def seed(self, number: int) -> None:
        """Sets the seed of SUMO's random numbers in the next runs, in the place of the scenario's."""
        self._options[self._options.index("--seed") + 1] = str(number)
        self._is_fresh = False

    def _use(self, names: list[str], neighbours: Floats, outlines: Floats) -> None:
        self.names, self.neighbours, self.outlines = names, neighbours, outlines
        self._in_sumo = [name for name in names if name not in self._paths]
        self._turned = [(row, name) for row, name in enumerate(self._in_sumo) if self._strays[name]]
        """Rows and names of the vehicles whose heading is SUMO's."""
        self._drifting = [(row, self._drifts[name]) for row, name in enumerate(names) if name in self._drifts]
        self._places, self._asides, self._speeds, self._headings = (column.data for column in outlines.T[geometry.SAID :])

    def _load(self, *, is_warm: bool = True) -> None:
        """Starts SUMO at the begin of the warm-up, or without it at time 0 of the run.

        Lanes without a limit get that of the scenario, as they have it in the corridor.
        """
        begin = self.scenario.begin - (self.scenario.warm_up if is_warm else 0.0)
        self._load_number = sumo.load([*self._options, "--begin", repr(begin)])
        self._is_forbidden = self._routes is None and all(entry.lane_change == "none" for entry in self._entries.values())
        if self._is_forbidden:
            sumo.forbid_lane_changes()
        limit = self.scenario.default_limit
        for lane in self.road.unlimited if limit is not None else ():
            sumo.lane.setMaxSpeed(lane, limit)
        self._loaded = self._is_fresh = True

    def reset(self, *, is_warm: bool = True) -> None:
        """Puts all vehicles to their starts, among the warm-up's. Raises TrafficError if SUMO refuses one.

        `is_warm`: false leaves the warm-up out, which most of a run's time may go to; flows begin at time 0 then.
        """
        try:
            is_here = self._loaded and sumo.is_current(self._load_number)
            if not (is_here and self._is_exact):
                if not (is_here and self._is_fresh and is_warm):
                    self._loaded = False
                    self._load(is_warm=is_warm)
                self._is_fresh = False
                steps = self._steps_before if is_warm else 0
                # A vehicle of a route file enters in the step that begins at its time: one step more, and vehicles of time 0 are there.
                for _ in range(steps + (self._routes is not None)):
                    STEP()
            else:
                sumo.clear()
            present = sorted(sumo.vehicle.getIDList()) if not self._is_exact else []
            entering = [name for name in present if self._routes is not None and name in self._routes.starting]
            driving = [name for name in present if name not in entering]
            missing = sumo.place(self._starts)
            self.starting = len(self._vehicles) + len(entering) + (0 if driving else len(self._paths))
            for path in self._paths.values():
                path.reset()
            if self._began is None:
                self.names = []
                self._enlist(self._vehicles + entering + driving)
            else:
                self._use([*self._vehicles, *self._paths], *(array.copy() for array in self._began))
                for start in self._starts[:-1]:
                    self._instruct(start.name)
        except SUMO_ERRORS as error:
            self._loaded = False
            raise TrafficError(f"scenarios.{self.name}: SUMO cannot place the vehicles: {self._said(error)}") from error
        if missing:
            self._loaded = False
            message = f"SUMO does not take the vehicles {', '.join(missing)}; place them farther apart"
            raise TrafficError(f"scenarios.{self.name}: {message}")
        self._actions.reset()
        self._track, self._ego = -1, self._ego_start
        if self._began is not None:
            return
        self._read_starts()
        if driving:
            self._make_room()
        if self._is_exact:
            self._began = self.neighbours.copy(), self.outlines.copy()

    def _make_room(self) -> None:
        """Removes vehicles of the warm-up that are too close to vehicles that start at time 0."""
        ego = self.scenario.ego
        start = np.array([self.start_s, self.start_d, ego.speed, 0.0, ego.length, ego.width])
        pose = self.road.start(self.start_s, self.start_d)
        outline = np.array([*pose, 0.5 * ego.length, 0.5 * ego.width, ego.speed, *[0.0] * 5])
        sideways = [0.0 if name in self._paths else sumo.vehicle.getLateralSpeed(name) for name in self.names]
        rows = too_close(self.neighbours, self.outlines, self.starting, start, outline, sideways)
        rows = [row for row in rows if self.names[row] not in self._paths]
        if not rows:
            return
        for row in rows:
            sumo.vehicle.remove(self.names[row])
        self._enlist([name for row, name in enumerate(self.names) if row not in rows])
        self._read_starts()

    def advance(self, index: int) -> bool:
        """Simulates step number `index`, at whose end the ego vehicle's place is `motion`, and reads all vehicles.

        `geometry.settle` must follow. Returns False if SUMO has taken the ego vehicle off the end of its route. Raises TrafficError if SUMO
        fails.
        """
        at = self._at
        try:
            if self._has_actions and self._actions.pending:
                self._act(index * self.step)
            self._guide(index)
            STEP()
            if (ARRIVED() or (not self._is_exact and DEPARTED())) and not self._update():
                if at[geometry.S] > self.road.length - self.scenario.ego.length - at[geometry.OWN_SPEED] * self.step:
                    return False
                raise TrafficError(f"scenarios.{self.name}: SUMO has removed the ego vehicle in step {index}")
            for path in self._paths.values():
                path.advance(self.step)
            self._read_speeds()
            if self.keeps_lanes:
                for row, offsets in self._drifting:
                    self._asides[row] = offsets[index]
            else:
                self._read_places()
        except SUMO_ERRORS as error:
            self._loaded = False
            raise TrafficError(f"scenarios.{self.name}: SUMO failed in step {index}: {self._said(error)}") from error
        return True

    def _update(self) -> bool:
        """Takes in the vehicles that have come, and leaves out vehicles that have arrived; returns whether the ego vehicle is there."""
        present = set(sumo.vehicle.getIDList())
        if present != {EGO, *self._in_sumo}:
            kept = [name for name in self._in_sumo if name in present]
            self._enlist(kept + sorted(present - {EGO, *kept}))
        self._loaded = EGO in present
        return self._loaded

    def _act(self, time: float) -> None:
        """Begins and continues actions, all vehicles being where they were at the end of the last step."""
        rows = zip(self.names, self.neighbours.tolist(), self.outlines[:, 5].tolist(), strict=True)
        vehicles = {name: Moving(row[0], row[1], along, 0.5 * row[4]) for name, row, along in rows}
        ego, stretch = self._ego
        self._actions.act(time, self.step, vehicles | {EGO: ego}, stretch)
        at = self._at
        ego = Moving(at[geometry.S], at[geometry.D], at[geometry.OWN_SPEED], at[geometry.SIZE])
        self._ego = ego, at[geometry.STRETCH]

    def _guide(self, index: int) -> None:
        """Puts SUMO's ego vehicle to where it reaches its place at the end of the step.

        Along its lane by the speed that leads there, which takes SUMO a tenth of the time of a search by coordinates; into its lane by
        name, also if SUMO took another one behind a split; by coordinates if its way in this step begins or ends inside of a junction, or
        begins before the route.
        """
        at, speed = self._at, self._at[geometry.OWN_SPEED]
        track, along = int(at[geometry.TRACK]), at[geometry.ALONG]
        if track == self._track and index % CHECKED_STEPS and (self._placed < self._border or self._is_followed(track)):
            way = max(along - self._placed, 0.0)
            self._placed += way
            SET_SPEED(EGO, way / self.step)
            return
        begin = along - speed * self.step
        (edge, lane, _), before = self.road.sumo.place(track, along), self.road.sumo.place(track, begin)
        self._track = track
        if edge.startswith(":") or before.edge.startswith(":") or before.position < 0.0:
            self._track = -1
            front = self.motion[geometry.FRONT : geometry.FRONT + 3].tolist()
            MOVE_TO_XY(EGO, edge, lane, *front, MAPPED_ANYWHERE, MAPPED_WITHIN)
            return
        sumo.vehicle.moveTo(EGO, f"{before.edge}_{before.lane}", before.position)
        SET_SPEED(EGO, speed)
        self._placed, self._border = along, self.road.sumo.end(track, begin)

    def _is_followed(self, track: int) -> bool:
        """Returns whether SUMO has moved the ego vehicle on into the lane of its track: a lane may lead to several."""
        edge, lane, _ = self.road.sumo.place(track, self._placed)
        if not edge.startswith(":") and sumo.vehicle.getLaneID(EGO) != f"{edge}_{lane}":
            return False
        self._border = self.road.sumo.end(track, self._placed)
        return True

    def _enlist(self, names: list[str]) -> None:
        """Replaces the arrays for other vehicles; new ones are told what they may do."""
        names = [*(name for name in names if name not in self._paths), *self._paths]
        neighbours, outlines = np.zeros((len(names), 6)), np.zeros((len(names), geometry.OUTLINED))
        rows = {name: row for row, name in enumerate(self.names)}
        for row, name in enumerate(names):
            if name in rows:
                neighbours[row], outlines[row] = self.neighbours[rows[name]], self.outlines[rows[name]]
                continue
            entry = self._entries.get(name)
            size = (entry.length, entry.width) if entry else (sumo.vehicle.getLength(name), sumo.vehicle.getWidth(name))
            path = self._paths.get(name)
            self._strays[name] = path is not None or not self._own.issuperset(sumo.vehicle.getRoute(name))
            s = geometry.nearest(self.road.line, *(GET_POSITION(name) if path is None else path.front()[:2])) - 0.5 * size[0]
            neighbours[row] = s, np.nan, 0.0, 0.0, *size
            outlines[row, 5] = GET_SPEED(name) if path is None else path.speed
            outlines[row, :2], outlines[row, geometry.SAID + 3] = np.nan, np.nan
            if path is None:
                self._instruct(name)
        self._use(names, neighbours, outlines)

    def _instruct(self, name: str) -> None:
        """Tells a vehicle of the scenario what it may do."""
        entry = self._entries.get(name)
        if entry is not None and entry.lane_change == "none" and not self._is_forbidden:
            sumo.vehicle.setLaneChangeMode(name, NO_LANE_CHANGES)
        if entry is not None and entry.model == "constant":
            sumo.vehicle.setSpeedMode(name, FREE)
            sumo.vehicle.setSpeed(name, entry.speed)

    def _read_speeds(self) -> None:
        self._speeds[: len(self._in_sumo)] = array("d", map(GET_SPEED, self._in_sumo))
        for row, path in enumerate(self._paths.values(), len(self._in_sumo)):
            self._speeds[row] = path.speed

    def _read_places(self) -> None:
        sumo.positions(self._in_sumo, self._places, self._asides)
        for row, path in enumerate(self._paths.values(), len(self._in_sumo)):
            self._places[row], self._asides[row], self._headings[row] = path.front()
        for row, name in self._turned:
            self._headings[row] = radians(90.0 - GET_ANGLE(name))
        if self.road.levels:
            self._leave_out_other_levels()

    def _read_starts(self) -> None:
        if self.keeps_lanes:
            for row, start in enumerate(self._starts[:-1]):
                edge, _, lane = start.lane.rpartition("_")
                track, place = self.road.sumo.along(edge, int(lane), start.position)
                self.outlines[row, geometry.SAID :] = place, 0.0, start.speed, track
        else:
            self._read_speeds()
            self._read_places()
            self._set_off()
        geometry.locate(self.road.line, self.road.lanes, self.neighbours, self.outlines, 0.0, self.keeps_lanes)

    def _set_off(self) -> None:
        """Moves the vehicles that start off the centre of their lane to their offset: SUMO does so in the first step only."""
        for row, start in enumerate(self._starts[:-1]):
            if start.offset:
                heading = radians(90.0 - GET_ANGLE(start.name))
                self.outlines[row, geometry.SAID : geometry.SAID + 2] += (
                    -start.offset * sin(heading),
                    start.offset * cos(heading),
                )

    def _leave_out_other_levels(self) -> None:
        """Gives vehicles above or below the road no place on it."""
        for row, name in enumerate(self._in_sumo):
            stretch = self.road.levels.get(GET_ROAD(name))
            if stretch is not None and stretch[0] <= GET_LANE_POSITION(name) <= stretch[1]:
                self.outlines[row, geometry.SAID : geometry.SAID + 2] = np.nan


def _centre(road: HighwayRoad, placed: Placed, field: str) -> tuple[float, float]:
    """Returns s and d of a vehicle's centre. Raises InvalidInputError."""
    with restated(lambda problem: replace(problem, field=f"{field}.{problem.field}")):
        if placed.edge is not None:
            return road.corridor.position(placed.edge, placed.lane, placed.s)
        return placed.s, road.centre(placed.s, placed.lane)[1]


def _front(road: HighwayRoad, placed: Placed, length: float, field: str) -> tuple[str, float]:
    """Returns lane and position along it of a vehicle's front. Raises InvalidInputError."""
    if placed.edge is None:
        with restated(lambda problem: replace(problem, field=f"{field}.{problem.field}")):
            piece, d = road.centre(placed.s, placed.lane)
        edge, lane, position = road.front(piece, placed.s, d, length)
    else:
        edge, lane, position = road.sumo.ahead(placed.edge, placed.lane, placed.s + 0.5 * length)
    name = f"{edge}_{lane}"
    end = float(sumo.lane.getLength(name))
    beyond = position - end
    if beyond > LARGEST_BEYOND and not isinstance(placed, Ego):  # the ego vehicle is put to its place after each step
        message = f"the vehicle's front would be {beyond:.2f} m beyond the end of the lane {name}, where SUMO cannot put it"
        raise InvalidInputError(Problem(f"{field}.s", message, f"give at most {placed.s - beyond:.2f}, or behind the junction"))
    return name, min(position, end)

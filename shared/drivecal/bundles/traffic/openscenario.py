"""OpenSCENARIO 1.x files: entities, their starts and the storyboard become the ego vehicle and the traffic of a scenario.

A declared subset is read. What has no effect on the drive is noted with its line; what would change it and is not supported is refused.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import ceil, inf, pi
from typing import Any, NamedTuple

import numpy as np

from drivecal.bundles.highway import OpenScenario
from drivecal.bundles.highway_actions import EGO
from drivecal.bundles.traffic.conditions import LARGEST, stop_time
from drivecal.bundles.traffic.elements import Element, Notes, declare, read_tree, substituted
from drivecal.bundles.traffic.entities import Catalogs, Entity, Files, bundle_path, entities_of
from drivecal.bundles.traffic.places import FilePlace, Map, along, links
from drivecal.bundles.traffic.storyboard import Storyboard, Ways, ignore_controller, ignore_global, target_speed
from drivecal.bundles.traffic.ways import FREE, Polyline, Pose, WayReader, is_turned
from drivecal.contracts.input_errors import nearest
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem, attempted, problems_of
from drivecal.roads.corridor import Corridor
from drivecal.roads.lines import project

_OTHER = re.compile(r"[^A-Za-z0-9_-]")
LONGEST = 64


class Entry(NamedTuple):
    """An entry of a scenario's traffic, as a document."""

    document: dict[str, Any]
    element: Element


class VehicleNames:
    """Ids of vehicles: names of files as they are, if they are ids, each only once."""

    def __init__(self, taken: Iterable[str | None]) -> None:
        self._taken = {EGO, *(name for name in taken if name is not None)}
        self._given: set[str] = set()

    def new(self, name: str, element: Element) -> str:
        """Returns the id of a vehicle of a file. Raises InvalidInputError if the file has another of this name."""
        if name in self._given:
            raise element.fault("another vehicle has the same name", "rename one")
        self._given.add(name)
        base = _OTHER.sub("_", name)[: LONGEST - 4] or "_"
        free, number = base, 1
        while free in self._taken:
            free, number = f"{base}-{number}", number + 1
        self._taken.add(free)
        return free


BEHIND = 2_000.0
"""Metres behind the ego vehicle's start from which a route that the file does not give begins, if vehicles start there; also the length of
the road ahead of it, or of the first vehicle, that is the drive until a route is known."""
SPARE = 1.5
"""A route that the file does not give is longer by this factor than the way at start speed, and at least `SHORTEST`."""
SHORTEST = 1_000.0


@dataclass(slots=True)
class _Start:
    """Start of an entity: the place of its centre, and its speed (m/s).

    `path`: its way, if it moves on no lane; `along`: metres on it to its centre, and `place` means nothing.
    """

    place: FilePlace
    speed: float
    path: Polyline | None = None
    along: float = 0.0


NOWHERE = FilePlace("", 0, 0.0, 0.0)


@dataclass(slots=True)
class _Init:
    """The starts of the entities that have one, by the actions of <Init>, in their order."""

    scenario: OpenScenario
    minor: str
    """Minor number of the file's version."""
    notes: Notes
    entities: Mapping[str, Entity]
    ego: str
    roads: Map
    reader: WayReader
    starts: dict[str, _Start] = field(default_factory=dict)
    places: dict[str, FilePlace] = field(default_factory=dict)
    poses: dict[str, Pose] = field(default_factory=dict)
    drive: tuple[str, ...] = ()
    """Edges of the ego vehicle's route, if the file has one."""

    def read(self, sections: Element) -> None:
        """Takes the actions. Raises InvalidInputError."""
        for section in sections.every("GlobalAction"):
            ignore_global(section, self.notes)
        for section in sections.every("Private"):
            name = section.text("entityRef")
            if name not in self.entities:
                raise section.fault(f"there is no entity {shown(name)}", nearest(name, list(self.entities)))
            kinds = [action.only(*_INIT) for action in section.every("PrivateAction")]
            # A distance in seconds is that at the start speed, whichever action comes first.
            kinds.sort(key=lambda kind: any(child.element == "LongitudinalDistanceAction" for child in kind.children))
            for kind in (kind for kind in kinds if kind.element == "TeleportAction"):
                known = self.places.get(self.ego, next(iter(self.places.values()), None))
                drive = self.scenario.route or (along(self.roads.network, known.edge, BEHIND) if known is not None else [])
                position = kind.only("Position")
                pose = self.reader.pose(position, self.places, self.poses, drive)
                way = self._ego_place(position, pose, drive) if name == self.ego else self._way(position, pose, drive)
                self.poses[name] = pose
                if isinstance(way, Polyline):
                    self.starts[name] = _Start(NOWHERE, 0.0, way, self.entities[name].centre)
                    continue
                self.places[name] = way
                self.starts[name] = _Start(self._centre(self.places[name], self.entities[name], kind), 0.0)
            for kind in (kind for kind in kinds if kind.element == "RoutingAction"):
                self._follow(kind, name)
            placed = self.starts[name].place if name in self.starts else None
            for kind in kinds:
                self._take(kind, name)
            if name in self.starts and self.starts[name].place is not placed:
                place = self.starts[name].place  # others are placed relative to its reference point
                self.places[name] = replace(place, position=place.position - self.entities[name].centre)
                self.poses[name] = self.reader.pose_of(self.places[name])

    def _ego_place(self, position: Element, pose: Pose, drive: Sequence[str]) -> FilePlace:
        """Returns the place on a lane where the ego vehicle starts."""
        if position.every(*FREE):
            return self.roads.ground.place(pose.x, pose.y, pose.heading, drive, position)
        place = self.roads.place(position, self.places, drive)
        if is_turned(pose, self.reader.pose_of(place).heading):
            self.notes.add(position.children[0], "the ego vehicle starts in the direction of its lane")
        return place

    def _way(self, position: Element, pose: Pose, drive: Sequence[str]) -> Polyline | FilePlace:
        """Returns the way of a vehicle that starts off the lanes, or in another direction than its lane; its place if it drives on it."""
        straight = Polyline(np.array([pose[:2], pose.moved(1e3, 0.0)[:2]]))
        if position.every(*FREE) or any("h" in each.values for each in position.every("WorldPosition")):
            ground, edges = self.roads.ground, self.roads.network.edges
            tried = [attempted(ground.place, pose.x, pose.y, heading, drive, position) for heading in (pose.heading, None)]
            near = [each for each in tried if not isinstance(each, InvalidInputError)]
            on = [each for each in near if abs(each.offset) <= 0.5 * edges[each.edge].lanes[each.index].width]
            if not (near or position.every(*FREE) or ground.is_beside(pose.x, pose.y)):
                raise InvalidInputError(*problems_of(tried[1]))
            place = next(iter(on if position.every(*FREE) else on + near), None)
        else:
            place = self.roads.place(position, self.places, drive)
        is_against = False
        if place is not None:
            heading = self.reader.pose_of(place).heading
            is_against = not is_turned(pose, heading + pi)
            if not is_turned(pose, heading):
                return place
        where = "against the direction of its lane" if is_against else "not on a lane in its direction"
        self.notes.add(position.children[0], f"{where}: it moves on no lane, unseen by SUMO's models")
        return self.reader.back(place) if place is not None and is_against else straight

    def _follow(self, kind: Element, name: str) -> None:
        """Takes a trajectory or a route of <Init>: the drive of the ego vehicle, or the path of another one."""
        action = kind.only("FollowTrajectoryAction", "AssignRouteAction")
        is_ego = name == self.ego
        if action.element == "AssignRouteAction":
            way = self.reader.route(action, self.places)
            if is_ego:
                self.drive = way.edges
                return
        elif is_ego:
            message = "the ego vehicle follows a trajectory, and the problem's controller drives it"
            raise action.fault(message, "give it a TeleportAction and, if it turns, an AssignRouteAction")
        else:
            way = self.reader.trajectory(action, self.places, self.poses)
            action.only("TimeReference").only("None")
            for mode in action.every("TrajectoryFollowingMode"):
                mode.skip()
        along, left = way.along(self.poses[name]) if name in self.poses else (0.0, 0.0)
        left = left if action.element == "AssignRouteAction" else 0.0  # a trajectory is followed as it is
        self.poses[name] = way.pose(along, left)
        self.notes.add(action, "driven on no lane, unseen by SUMO's models")
        self.starts[name] = _Start(NOWHERE, 0.0, way.shifted(left), along + self.entities[name].centre)

    def _centre(self, place: FilePlace, entity: Entity, element: Element) -> FilePlace:
        """Returns the place of an entity's centre: positions mean another point, e.g. that of the rear axle."""
        if entity.centre == 0.0:
            return place
        moved = self.roads.moved(place, entity.centre, element)
        return FilePlace(moved.edge, moved.index, moved.position, place.offset)

    def _take(self, kind: Element, name: str) -> None:
        """Takes an action of <Init> other than the place."""
        if kind.element in {"TeleportAction", "RoutingAction"}:
            return
        if kind.element != "LongitudinalAction":
            if name == self.ego:
                kind.skip()
                self.notes.add(kind, "ignored: the problem's controller drives the ego vehicle")
            else:
                ignore_controller(kind, self.notes)
            return
        if name not in self.starts:
            raise kind.fault(f"{shown(name)} has no place", "give it a TeleportAction before")
        action = kind.only("SpeedAction", "LongitudinalDistanceAction")
        if action.element == "SpeedAction":
            dynamics = action.only("SpeedActionDynamics")
            if dynamics.text("dynamicsShape", "step") != "step" and dynamics.number("value", -LARGEST, LARGEST, 0.0) != 0.0:
                self.notes.add(dynamics, "ignored: the vehicle has this speed from the start")
            dynamics.skip()
            target = target_speed(
                action.only("SpeedActionTarget").only("AbsoluteTargetSpeed", "RelativeTargetSpeed"),
                {other: other for other in self.starts},
            )
            if target.get("continuous", False):
                raise action.fault(
                    "a start speed that is kept to another vehicle's is not supported",
                    'give continuous="false", and an event with this SpeedAction',
                )
            speed = target.get("speed", 0.0)
            if (other := target.get("like")) is not None:
                speed += target.get("factor", 1.0) * self.starts[other].speed
            if not 0.0 <= speed <= 100.0:
                raise action.fault(f"the start speed is {speed:g} m/s", "give 0 to 100")
            self.starts[name].speed = speed
            return
        self.starts[name].place = self._spaced(action, name)

    def _spaced(self, action: Element, name: str) -> FilePlace:
        """Returns the place at a distance to another entity: before it, or behind it."""
        other = action.text("entityRef")
        if any(self.starts[entity].path is not None for entity in (name, other) if entity in self.starts):
            raise action.fault("a distance of an entity that is on no lane is not supported", "give its place")
        if other not in self.starts:
            raise action.fault(f"{shown(other)} has no place yet", "give its place or its actions before")
        if action.decides("continuous", "false"):
            raise action.fault("a distance that is kept is not supported", 'give continuous="false", or a SpeedAction')
        default = "any" if self.minor == "0" else "trailingReferencedEntity"
        displacement = action.word("displacement", ("leadingReferencedEntity", "trailingReferencedEntity", "any"), default)
        is_ahead = displacement == "leadingReferencedEntity"
        if displacement == "any":
            is_ahead = _is_ahead(self.starts[name].place, self.starts[other].place, self.roads, action)
        follower = self.starts[other] if is_ahead else self.starts[name]
        if "timeGap" in action.values:
            distance = action.number("timeGap", 0.0, 1_000.0) * follower.speed
        else:
            distance = action.number("distance", 0.0, LARGEST)
        if action.decides("freespace", "true"):
            distance += 0.5 * (self.entities[name].length + self.entities[other].length)
        moved = self.roads.moved(self.starts[other].place, distance if is_ahead else -distance, action)
        lanes, mine = self.roads.network.edges[moved.edge].lanes, self.starts[name].place
        shift = mine.index - self.starts[other].place.index if mine.edge == self.starts[other].place.edge else 0
        if not 0 <= moved.index + shift < len(lanes):
            raise action.fault("there is no lane at this distance", "give another distance")
        return FilePlace(moved.edge, moved.index + shift, min(moved.position, lanes[moved.index + shift].length), mine.offset)


class ScenarioFile:
    """An OpenSCENARIO file with the parameters of a scenario."""

    def __init__(self, scenario: OpenScenario, files: Files) -> None:
        """Reads the file. Raises InvalidInputError."""
        self.name, self._scenario, self._files = scenario.openscenario, scenario, files
        self._root = read_tree(files.read(self.name), self.name, "OpenSCENARIO", substituted)
        self._notes = Notes(self.name)
        header = self._root.only("FileHeader")
        header.skip()
        self._minor = header.text("revMinor", "0").strip()
        if header.text("revMajor") != "1":
            message = f"OpenSCENARIO of version {shown(header.text('revMajor'), 10)} cannot be read, only 1.x"
            raise header.fault(message, "export the file as OpenSCENARIO 1.0 to 1.3")
        if (values := self._root.optional("ParameterValueDistribution")) is not None:
            message = "the file has values for a scenario's parameters, and no scenario"
            raise values.fault(message, "give the file of its <ScenarioFile> as `openscenario`, with values in `parameters`")
        declare(self._root, scenario.parameters)
        self.notes: tuple[str, ...] = ()

    @property
    def network(self) -> str:
        """Path of the network in the bundle. Raises InvalidInputError if the file names a path that no bundle can have."""
        logic = self._root.only("RoadNetwork").optional("LogicFile")
        if self._scenario.network is not None:
            return self._scenario.network
        if logic is None:
            raise self._root.only("RoadNetwork").fault("it names no road", "give `network` in the scenario")
        path = bundle_path(self.name, logic.text("filepath"), logic)
        if path not in self._files.names:
            message = f"the folder of the problem has no file {shown(path, 200)}"
            raise logic.fault(message, "copy it there, or give `network` in the scenario")
        return path

    def described(self, roads: Map, corridor_of: Any, step: float, names: VehicleNames) -> tuple[dict[str, Any], list[Entry]]:
        """Returns network, route, duration and ego vehicle as a document, and the other vehicles.

        `corridor_of`: returns the corridor of a route; `step`: the simulator's (s). Raises InvalidInputError.
        """
        scenario, storyboard = self._scenario, self._root.only("Storyboard")
        self._root.only("RoadNetwork").optional("LogicFile")
        entities = entities_of(self._root, self._files, self._notes)
        ego = self._ego(entities)
        duration = self._duration(storyboard, step)
        reader = WayReader(roads, Catalogs(self._root, self._files))
        init = _Init(scenario, self._minor, self._notes, entities, ego.name, roads, reader)
        init.read(storyboard.only("Init").only("Actions"))
        starts = init.starts
        if ego.name not in starts:
            raise ego.element.fault("it has no place", "give it a TeleportAction in <Init>")
        route = scenario.route or list(init.drive) or self._route(starts, ego, roads, duration)
        present = {name: entity for name, entity in entities.items() if name in starts}
        ids = {name: EGO if name == ego.name else names.new(name, entity.element) for name, entity in present.items()}
        ways = {ids[name]: self._way(start, route, roads, duration) for name, start in starts.items() if start.path is None}
        paths = {ids[name]: start.path for name, start in starts.items() if start.path is not None}

        def reached(position: Element) -> tuple[float, float]:
            for relative in position.every(
                *(child.element for child in position.children if child.element.startswith("Relative"))
            ):
                message = f"a place that moves with {shown(relative.text('entityRef'))} is not supported"
                raise relative.fault(message, "give a place on the road, or a RelativeDistanceCondition")
            corridor: Corridor = corridor_of(route)
            if position.every(*FREE):
                point = np.array([reader.pose(position, {}, {}, route)[:2]])
                near = corridor.line[np.argmin(np.hypot(*(corridor.line[:, 1:3] - point).T)), 0]
                foot, left = (float(value[0]) for value in project(corridor.line, point, np.array([near])))
                if not 0.0 <= foot <= float(corridor.line[-1, 0]):
                    raise position.fault("the place is not beside the route", "give a place on the scenario's route")
                return foot, left
            place = roads.place(position, {}, route)
            try:
                s, d = corridor.position(place.edge, place.index, place.position)
            except InvalidInputError as error:
                raise position.fault(error.problems[0].message, "give a place on the scenario's route") from error
            return s, d + place.offset

        centres = {ids[name]: entity.centre for name, entity in present.items()}
        every = Ways(ways, roads, paths, reader)
        actions = Storyboard(storyboard, ids, centres, every, reached, duration, self._notes).actions
        document = {"route": route, "duration": duration, "ego": _placed(starts[ego.name], ego)}
        entries = [
            Entry(self._vehicle(entity, starts[name], ids[name], ways.get(ids[name], []), route, actions), entity.element)
            for name, entity in present.items()
            if name != ego.name
        ]
        for name, entity in entities.items():
            if name not in starts:
                self._notes.add(entity.element, "left out: it has no place in <Init>")
        self.notes = self._notes.texts(self._root)
        return document, entries

    def _ego(self, entities: Mapping[str, Entity]) -> Entity:
        named = [name for name in entities if name.lower() == self._scenario.ego.lower()]
        if len(named) != 1:
            message = f"{self.name} has no entity {shown(self._scenario.ego)}"
            raise InvalidInputError(Problem("ego", message, nearest(self._scenario.ego, list(entities))))
        return entities[named[0]]

    def _duration(self, storyboard: Element, step: float) -> float:
        """Returns the scenario's duration (s), or the first multiple of the step that is as long as the file's."""
        trigger = storyboard.optional("StopTrigger")
        if self._scenario.duration is not None:
            if trigger is not None and trigger.children:
                trigger.skip()
                self._notes.add(trigger, "ignored: the scenario has its own duration")
            return self._scenario.duration
        groups = trigger.every("ConditionGroup") if trigger else []
        times = [time for group in groups if (time := stop_time(group)) is not None]
        if min(times, default=inf) > 3_600.0:
            message = "the file has no time up to 3600 s at which it stops"
            raise (trigger or storyboard).fault(message, "give `duration` in the scenario")
        for group in groups:
            if stop_time(group) is None:
                group.skip()
                self._notes.add(group, "ignored: the run lasts until the time of the StopTrigger")
        return round(max(1, ceil(min(times) / step - 1e-9)) * step, 9)

    def _route(self, starts: Mapping[str, _Start], ego: Entity, roads: Map, duration: float) -> list[str]:
        """Returns the route along the road of the ego vehicle. It begins at the farthest vehicle behind it."""
        start = starts[ego.name]
        length = start.place.position + max(SHORTEST, SPARE * max(start.speed, 10.0) * duration)
        ahead = along(roads.network, start.place.edge, length)
        before: Sequence[str] = ()
        for other in (start for start in starts.values() if start.path is None):
            way = along(roads.network, other.place.edge, BEHIND)
            if start.place.edge in way[1:]:
                before = max(before, way[: way.index(start.place.edge)], key=len)
        route = [*before, *(edge for edge in ahead if edge not in before)]
        self._notes.add(self._root, f"the route is [{', '.join(route[:20])}{', ...' if len(route) > 20 else ''}]")
        return route

    def _way(self, start: _Start, route: Sequence[str], roads: Map, duration: float) -> list[str]:
        """Returns the edges that a vehicle drives: the rest of the route as far as its lane leads along it, or along its own road."""
        if start.place.edge in route:
            way, index = list(route[route.index(start.place.edge) :]), start.place.index
            for number, (edge, after) in enumerate(pairwise(way), 1):
                ahead = [link for link in links(roads.network, edge) if link.from_lane == index]
                if ahead and after not in {link.end for link in ahead}:
                    return [*way[:number], *along(roads.network, ahead[0].end, SHORTEST)]
                index = next((link.to_lane for link in ahead if link.end == after), index)
            return way
        length = start.place.position + max(SHORTEST, SPARE * max(start.speed, 10.0) * duration)
        way = along(roads.network, start.place.edge, length)
        joins = next((index for index, edge in enumerate(way) if edge in route), None)
        return way if joins is None else [*way[:joins], *route[route.index(way[joins]) :]]

    def _vehicle(
        self,
        entity: Entity,
        start: _Start,
        name: str,
        way: list[str],
        route: Sequence[str],
        actions: Mapping[str, list[dict[str, Any]]],
    ) -> dict[str, Any]:
        document: dict[str, Any] = {"id": name, "model": "constant", "vehicle_class": entity.vehicle_class}
        if start.path is not None:
            points, s = start.path.points.round(6).tolist(), start.along
            if s < 0.0:
                points, s = [list(start.path.pose(s)[:2]), *points], 0.0
            size = {"length": entity.length, "width": entity.width}
            return document | {"path": points, "s": s, "speed": start.speed, "actions": actions.get(name, [])} | size
        document |= _placed(start, entity)
        changes_lane = any(action["do"] == "cut_in" for action in actions.get(name, []))
        if start.place.edge not in route or not (set(way) <= set(route) or changes_lane):
            document["route"] = way
        return document | {"actions": actions.get(name, [])}


_INIT = (
    "TeleportAction",
    "RoutingAction",
    "LongitudinalAction",
    "ControllerAction",
    "ActivateControllerAction",
    "VisibilityAction",
    "AppearanceAction",
)


def _placed(start: _Start, entity: Entity) -> dict[str, Any]:
    place = start.place
    return {
        "edge": place.edge,
        "lane": place.index,
        "s": max(place.position, 0.0),
        "offset": place.offset if abs(place.offset) > 1e-3 else 0.0,
        "speed": start.speed,
        "length": entity.length,
        "width": entity.width,
    }


def _is_ahead(place: FilePlace, other: FilePlace, roads: Map, element: Element) -> bool:
    """Returns whether a place lies ahead of another one along the road. Raises InvalidInputError if it lies on none of its sides."""
    if place.edge == other.edge and place.position != other.position:
        return place.position > other.position
    if place.edge != other.edge:
        for begin, end, is_ahead in ((other, place, True), (place, other, False)):
            if end.edge in along(roads.network, begin.edge, BEHIND):
                return is_ahead
    message = "the vehicle's place is neither ahead of the other's nor behind it"
    raise element.fault(message, 'give displacement="leadingReferencedEntity" or "trailingReferencedEntity"')

"""Ways of OpenSCENARIO files that are on no lane, or lead over several roads: trajectories, routes, and places along them."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import atan2, cos, pi, sin
from typing import NamedTuple

import numpy as np

from drivecal.bundles.traffic.elements import Element, declare
from drivecal.bundles.traffic.entities import Catalogs
from drivecal.bundles.traffic.places import FilePlace, Map, links, projected
from drivecal.domain.errors import InvalidInputError, attempted
from drivecal.domain.roads import Floats
from drivecal.roads.lines import lengths

MOST_POINTS = 10_000
FREE = ("RelativeObjectPosition", "RelativeWorldPosition", "TrajectoryPosition", "RoutePosition")
"""Positions that are not given by a lane or a road."""
DEEPEST = 5
"""Trajectories inside of each other."""


class Pose(NamedTuple):
    """A place in the network's coordinates (m), and a heading (rad)."""

    x: float
    y: float
    heading: float

    def moved(self, ahead: float, left: float) -> "Pose":
        """Returns the pose at distances (m) ahead and to the left."""
        forward, aside = cos(self.heading), sin(self.heading)
        return Pose(self.x + ahead * forward - left * aside, self.y + ahead * aside + left * forward, self.heading)


class Polyline(NamedTuple):
    """A polyline (n, 2); of a route also its edges."""

    points: Floats
    edges: tuple[str, ...] = ()

    def pose(self, along: float, left: float = 0.0) -> Pose:
        """Returns the pose at a length (m) along it and to its left; straight on beyond its ends."""
        s = lengths(self.points)
        row = int(np.clip(np.searchsorted(s, along, side="right") - 1, 0, len(s) - 2))
        (x, y), (dx, dy) = self.points[row], self.points[row + 1] - self.points[row]
        return Pose(float(x), float(y), atan2(dy, dx)).moved(along - float(s[row]), left)

    def along(self, pose: Pose) -> tuple[float, float]:
        """Returns the length (m) along it of the point that is closest to a pose, and how far the pose is to its left (m)."""
        share, left, _, _ = projected(self.points, pose.x, pose.y)
        return share * float(lengths(self.points)[-1]), left

    def shifted(self, left: float) -> "Polyline":
        """Returns the way at a distance (m) to the left."""
        if abs(left) < 1e-9:
            return self
        s = lengths(self.points)
        poses = [self.pose(float(at), left) for at in (*s[:-1], float(s[-1]) - 1e-6)]
        return Polyline(np.array([pose[:2] for pose in poses]), self.edges)


class WayReader:
    """Reads ways and free positions of a file."""

    def __init__(self, roads: Map, catalogs: Catalogs) -> None:
        self._roads, self.catalogs = roads, catalogs

    def resolved(self, reference: Element, tag: str) -> Element:
        """Returns the <Trajectory>, <Route> or <Maneuver> in an element, or in a catalog that it names. Raises InvalidInputError."""
        child = reference.only(tag, f"{tag}Ref", "CatalogReference")
        if child.element == f"{tag}Ref":
            return self.resolved(child, tag)
        if child.element != tag:
            return self.catalogs.entry(child, tag)
        declare(child, {})
        return child

    def trajectory(
        self, reference: Element, places: Mapping[str, FilePlace], poses: Mapping[str, Pose], depth: int = 0
    ) -> Polyline:
        """Returns the polyline of a trajectory. Raises InvalidInputError for other shapes."""
        trajectory = self.resolved(reference, "Trajectory")
        if depth > DEEPEST:
            raise trajectory.fault(f"more than {DEEPEST} trajectories lie inside of each other", "give one by places of lanes")
        if trajectory.decides("closed", "false"):
            raise trajectory.fault("a closed trajectory is not supported", 'give closed="false"')
        vertices = trajectory.only("Shape").only("Polyline").every("Vertex")
        if not 2 <= len(vertices) <= MOST_POINTS:
            raise trajectory.fault(f"it has {len(vertices)} vertices", f"give 2 to {MOST_POINTS:,}")
        corners = [self.pose(vertex.only("Position"), places, poses, (), depth + 1) for vertex in vertices]
        points = [pose[:2] for number, pose in enumerate(corners) if number == 0 or pose[:2] != corners[number - 1][:2]]
        if len(points) < 2:
            raise trajectory.fault("all its vertices are one place", "give two different places")
        return Polyline(np.array(points))

    def route(self, reference: Element, places: Mapping[str, FilePlace]) -> Polyline:
        """Returns the way of a route along the lanes from its first waypoint to its last. Raises InvalidInputError."""
        route = self.resolved(reference, "Route")
        if route.decides("closed", "false"):
            raise route.fault("a closed route is not supported", 'give closed="false"')
        waypoints = route.every("Waypoint")
        if len(waypoints) < 2:
            raise route.fault("it has less than two waypoints", "give two")
        stops = [self._roads.place(waypoint.only("Position"), places, ()) for waypoint in waypoints]
        edges = [stops[0].edge]
        for waypoint, place in zip(waypoints[1:], stops[1:], strict=True):
            waypoint.text("routeStrategy", "shortest")
            edges += self._between(edges[-1], place.edge, waypoint)
        return Polyline(self._lanes(stops[0], edges), tuple(edges))

    def _between(self, first: str, last: str, element: Element) -> list[str]:
        """Returns the edges after one edge up to another, by the least number of edges. Raises InvalidInputError if there is no way."""
        before: dict[str, str] = {}
        waiting = [first]
        while waiting and last not in before and first != last:
            following = []
            for edge in waiting:
                for link in links(self._roads.network, edge):
                    if link.end != first and link.end not in before:
                        before[link.end] = edge
                        following.append(link.end)
            waiting = following
        way = [last] if first != last else []
        while way and way[-1] != first:
            if way[-1] not in before:
                raise element.fault(f"no way leads from the edge {first} to {last}", "give a waypoint that is reached")
            way.append(before[way[-1]])
        return way[::-1][1:]

    def _lanes(self, place: FilePlace, edges: Sequence[str]) -> Floats:
        """Returns the centre line of a lane behind a place, and of the lanes that follow along the edges."""
        network, index = self._roads.network, place.index
        shape, metres = self._shape(place)
        parts = [Polyline(shape).pose(metres)[:2], *shape[lengths(shape) > metres + 1e-6].tolist()]
        for edge, after in pairwise(edges):
            ways = [link for link in links(network, edge) if link.end == after]
            link = next((link for link in ways if link.from_lane == index), ways[0])
            inner = network.lane(link.via) if link.via is not None else None
            parts += inner.shape.tolist() if inner is not None else []
            index = link.to_lane
            parts += network.edges[after].lanes[index].shape.tolist()
        points = np.array(parts)
        return np.asarray(points[np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > 1e-6])])

    def pose(
        self,
        position: Element,
        places: Mapping[str, FilePlace],
        poses: Mapping[str, Pose],
        drive: Sequence[str],
        depth: int = 0,
    ) -> Pose:
        """Returns the pose of a <Position> of any kind.

        Args:
            position: The element.
            places: Places of the entities that are known so far.
            poses: Their poses.
            drive: Edges of the ego vehicle's drive, as far as they are known.
            depth: Number of trajectories around it.

        Raises InvalidInputError.
        """
        self._roads.check_time()
        kind = next((child for child in position.every(*FREE)), None)
        world = next((each for each in position.every("WorldPosition") if depth or "h" in each.values), None)
        is_left = False
        if world is not None:
            x, y, heading = self._roads.coordinates(world)
            pose, kind = Pose(x, y, heading or 0.0), world
        elif kind is None:
            place = self._roads.place(position, places, drive)
            pose, kind, is_left = self.pose_of(place), position.children[0], place.lane > 0
        elif kind.element == "TrajectoryPosition":
            way = self.trajectory(kind, places, poses, depth)
            pose = way.pose(kind.number("s", 0.0, 1e6), kind.number("t", -1e3, 1e3, 0.0))
        elif kind.element == "RoutePosition":
            pose = self._on_route(kind, places)
        else:
            other = kind.text("entityRef")
            if other not in poses:
                raise kind.fault(f"the place of {other[:60]!r} is not known", "place it before")
            dx, dy = (kind.number(key, -1e5, 1e5) for key in ("dx", "dy"))
            at = poses[other]
            pose = at.moved(dx, dy) if kind.element == "RelativeObjectPosition" else Pose(at.x + dx, at.y + dy, at.heading)
        orientation = kind.optional("Orientation")
        if orientation is None:
            return pose
        turn = orientation.number("h", -100.0, 100.0, 0.0)
        unsaid = "absolute" if turn and kind.element in {"LanePosition", "RoadPosition"} else "relative"
        is_absolute = orientation.word("type", ("relative", "absolute"), unsaid) == "absolute"
        if is_absolute:
            return pose._replace(heading=turn)
        turned = pose._replace(heading=pose.heading + turn)
        # Files count headings along a left lane from the lane's direction, as esmini does, and across it from the road's.
        is_across = is_left and is_turned(turned, pose.heading) and is_turned(turned, pose.heading + pi)
        return turned._replace(heading=turned.heading + pi) if is_across else turned

    def _on_route(self, kind: Element, places: Mapping[str, FilePlace]) -> Pose:
        """Returns the pose of a <RoutePosition>."""
        way = self.route(kind.only("RouteRef"), places)
        at = kind.only("InRoutePosition").only("FromRoadCoordinates", "FromLaneCoordinates")
        along = at.number("pathS", 0.0, 1e6)
        if at.element == "FromRoadCoordinates":
            return way.pose(along)  # the lane of the first waypoint counts, and `t` is noted as ignored
        pose, lane = way.pose(along), at.integer("laneId", -64, 64)
        there = attempted(self._roads.ground.place, pose.x, pose.y, pose.heading, way.edges, at)
        own = 0 if isinstance(there, InvalidInputError) else self._roads.road_lane(there)  # none in a junction
        if own and lane != own:
            message = f"laneId is {lane}, and the way of the waypoints is on lane {own} there"
            raise at.fault(message, "give waypoints on the lane that is meant")
        return way.pose(along, at.number("laneOffset", -50.0, 50.0, 0.0))

    def pose_of(self, place: FilePlace) -> Pose:
        """Returns the pose of a place on a lane, in the lane's direction."""
        shape, metres = self._shape(place)
        return Polyline(shape).pose(metres, place.offset)

    def _shape(self, place: FilePlace) -> tuple[Floats, float]:
        """Returns the centre line of a place's lane and the metres along it: SUMO's positions are stretched."""
        lane = self._roads.network.edges[place.edge].lanes[place.index]
        return lane.shape, place.position / max(lane.length, 1e-9) * float(lengths(lane.shape)[-1])

    def back(self, place: FilePlace) -> Polyline:
        """Returns the way from a place on a lane to the lane's begin, against its direction."""
        shape, metres = self._shape(place)
        before = shape[lengths(shape) < metres - 1e-3][::-1]
        points = np.vstack([[Polyline(shape).pose(metres)[:2]], before if len(before) else [Polyline(shape).pose(-100.0)[:2]]])
        return Polyline(points).shifted(-place.offset)


def is_turned(pose: Pose, heading: float) -> bool:
    """Returns whether a pose has another direction than a heading: by more than a quarter of a right angle."""
    return abs((pose.heading - heading + pi) % (2.0 * pi) - pi) > pi / 8.0

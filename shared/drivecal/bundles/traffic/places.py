"""Places of OpenSCENARIO files on SUMO's lanes: by road and lane of the OpenDRIVE file, by coordinates, or from another place."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from math import cos, sin

import numpy as np

from drivecal.bundles.traffic.coordinates import DECIMALS, FilePlace, Ground, nearest
from drivecal.bundles.traffic.elements import Element
from drivecal.bundles.traffic.routes import links
from drivecal.contracts.strict_json import shown
from drivecal.roads.network import Lane, Network
from drivecal.roads.opendrive import FileRoad, RoadFile

MOST_LANES = 1_000
"""Lanes in a row over which a relative place may lie."""
LARGEST = 1e6


class Map:
    """A network with the OpenDRIVE file that it was made of, if there is one."""

    def __init__(self, network: Network, source: Callable[[], RoadFile] | None) -> None:
        """`source`: reads the OpenDRIVE file."""
        self.network, self._source = network, source
        roads = [lane for edge in network.edges.values() if edge.function == "" for lane in edge.lanes]
        self._ground = Ground(network)
        self._by_origin: dict[str, list[Lane]] = {}
        for lane in roads:
            for origin in (lane.origin or "").split():
                self._by_origin.setdefault(origin, []).append(lane)

    @cached_property
    def file(self) -> RoadFile | None:
        """The OpenDRIVE file, None if the network was not made of one. Raises InvalidInputError."""
        return None if self._source is None else self._source()

    def place(self, position: Element, places: Mapping[str, FilePlace], route: Sequence[str]) -> FilePlace:
        """Returns the place of a <Position>. `places`: of the entities that are known so far; `route`: of the drive, if it is known. Raises
        InvalidInputError.
        """
        kind = position.only("LanePosition", "WorldPosition", "RoadPosition", "RelativeLanePosition", "RelativeRoadPosition")
        if kind.element == "WorldPosition":
            x, y = (kind.number(key, -1e8, 1e8) for key in ("x", "y"))
            heading = kind.number("h", -10.0, 10.0) if "h" in kind.values else None
            moved = (0.0, 0.0) if self._source is not None else self.network.offset
            return self._ground.place(x + moved[0], y + moved[1], heading, route, kind)
        if kind.element == "LanePosition":
            road = self._road(kind)
            lane, s = kind.integer("laneId", -64, 64), kind.number("s", 0.0, LARGEST)
            return self._on_lane(road, lane, s, kind.number("offset", -10.0, 10.0, 0.0), kind)
        if kind.element == "RoadPosition":
            return self._on_road(self._road(kind), kind.number("s", 0.0, LARGEST), kind.number("t", -100.0, 100.0), kind)
        other = kind.text("entityRef")
        if other not in places:
            raise kind.fault(f"the place of {shown(other)} is not known", "give it one by a road, a lane or coordinates")
        there, ds = places[other], kind.number("ds", -LARGEST, LARGEST)
        if kind.element == "RelativeRoadPosition":
            if there.road is None:
                raise kind.fault(f"{shown(other)} is not placed by a road of the file", "give a LanePosition")
            return self._on_road(self._road(kind, there.road), there.s + ds, there.t + kind.number("dt", -100.0, 100.0), kind)
        offset = kind.number("offset", -10.0, 10.0, 0.0)
        return self._beside(there, kind.integer("dLane", -30, 30), ds, offset, kind)

    def lane_index(self, edge: str, road_lane: int) -> int | None:
        """Returns the index of the lane of an edge that was made of a lane of its road, None if there is none."""
        for lane in self.network.edges[edge].lanes:
            if any(origin.rpartition("_")[2] == str(road_lane) for origin in (lane.origin or "").split()):
                return lane.index
        return None

    def moved(self, place: FilePlace, metres: float, element: Element) -> FilePlace:
        """Returns the place that lies so many metres along the lanes from a place, or before it. Raises InvalidInputError if they end."""
        lane, position = self.network.edges[place.edge].lanes[place.index], place.position + metres
        for _ in range(MOST_LANES):
            if 0.0 <= position <= lane.length:
                return replace(place, edge=lane.edge, index=lane.index, position=round(position, DECIMALS), road=None)
            following = self._following(lane, ahead=position > 0.0)
            if following is None:
                break
            other, inside = following
            position = (
                max(position - lane.length - inside, 0.0) if position > 0.0 else other.length + min(position + inside, 0.0)
            )
            lane = other
        raise element.fault("the lane ends before that place", "give a place on the lane")

    def _following(self, lane: Lane, *, ahead: bool) -> tuple[Lane, float] | None:
        """Returns the lane after a lane or before it, and the metres inside of the junction between them."""
        network = self.network
        for source in (lane.edge,) if ahead else network.connections:
            for link in links(network, source) if source in network.edges else ():
                ends = ((source, link.from_lane), (link.end, link.to_lane))
                mine, (edge, index) = ends if ahead else ends[::-1]
                if mine == (lane.edge, lane.index) and not edge.startswith(":") and index < len(network.edges[edge].lanes):
                    between = network.lane(link.via) if link.via is not None else None
                    return network.edges[edge].lanes[index], between.length if between is not None else 0.0
        return None

    def _road(self, element: Element, name: str | None = None) -> FileRoad:
        if self.file is None:
            raise element.fault("the network is not an OpenDRIVE file, so that roads are not known", "give a WorldPosition")
        name = element.text("roadId") if name is None else name
        if name not in self.file.roads:
            roads = ", ".join(shown(road, 30) for road in list(self.file.roads)[:10])
            raise element.fault(f"{self.file.name} has no road {shown(name)}", f"give one of {roads}")
        return self.file.roads[name]

    def _on_lane(self, road: FileRoad, lane: int, s: float, offset: float, element: Element) -> FilePlace:
        """Returns the place beside a lane's centre."""
        if not 0.0 <= s <= road.length:
            message = f"road {shown(road.id)} is {road.length:.2f} m long, and has no s = {s:g} m"
            raise element.fault(message, f"give 0 to {road.length:.2f}")
        section = road.section_at(s)
        lanes = road.sections[section].lanes
        if lane == 0 or lane not in lanes:
            known = ", ".join(str(index) for index in sorted(lanes) if index != 0)
            raise element.fault(f"road {shown(road.id)} has no lane {lane} at s = {s:g} m", f"give one of {known}")
        points, _ = road.centre(section, lane, np.array([s]))
        x, y, heading = (float(column[0]) for column in road.reference(np.array([s])))
        t = (float(points[0, 1]) - y) * cos(heading) - (float(points[0, 0]) - x) * sin(heading)
        candidates = self._by_origin.get(f"{road.id}_{lane}")
        if candidates is None:
            kind = lanes[lane].kind
            raise element.fault(
                f"lane {lane} of road {shown(road.id)}, of type {shown(kind)}, is not driven on", "give another"
            )
        there = nearest(candidates, float(points[0, 0]), float(points[0, 1]), element)
        left = 1.0 if lane < 0 else -1.0
        return replace(there, offset=round(offset * left, DECIMALS), road=road.id, lane=lane, s=s, t=t + offset)

    def _on_road(self, road: FileRoad, s: float, t: float, element: Element) -> FilePlace:
        """Returns the place at a distance to the left of a road's reference line."""
        if not 0.0 <= s <= road.length:
            message = f"road {shown(road.id)} is {road.length:.2f} m long, and has no s = {s:g} m"
            raise element.fault(message, f"give 0 to {road.length:.2f}")
        x, y, heading = (float(column[0]) for column in road.reference(np.array([s])))
        lanes = [lane for name, lanes in self._by_origin.items() if name.rpartition("_")[0] == road.id for lane in lanes]
        there = nearest(lanes, x - t * sin(heading), y + t * cos(heading), element)
        origin = (self.network.edges[there.edge].lanes[there.index].origin or "").split()
        lane = next((int(name.rpartition("_")[2]) for name in origin if name.rpartition("_")[0] == road.id), 0)
        return replace(there, road=road.id, lane=lane, s=s, t=t)

    def _beside(self, there: FilePlace, lanes: int, ds: float, offset: float, element: Element) -> FilePlace:
        """Returns the place `ds` metres ahead of another, on the lane whose number is larger by `lanes`."""
        road = None if there.road is None or self.file is None else self.file.roads[there.road]
        ahead = -1.0 if (there.lane or self._road_lane(there)) > 0 else 1.0
        if road is not None and 0.0 <= there.s + ahead * ds <= road.length:
            lane = there.lane + lanes
            if lanes and (lane == 0 or (lane > 0) != (there.lane > 0)):
                lane += 1 if lanes > 0 else -1  # lane 0 is the middle of the road
            if lane in road.sections[road.section_at(there.s + ahead * ds)].lanes:
                return self._on_lane(road, lane, there.s + ahead * ds, offset, element)
        reached = self.moved(there, ds, element)
        index = reached.index + (lanes if ahead > 0.0 else -lanes)
        if not 0 <= index < len(self.network.edges[reached.edge].lanes):
            raise element.fault(f"there is no lane {lanes:+d} beside that of the other vehicle", "give another dLane")
        return replace(reached, index=index, offset=round(ahead * offset, DECIMALS))

    def _road_lane(self, place: FilePlace) -> int:
        """Returns the number of the lane of the file on which a place is, 0 if the network was not made of one."""
        origins = (self.network.edges[place.edge].lanes[place.index].origin or "").split() if self._source is not None else []
        return int(origins[0].rpartition("_")[2]) if origins else 0

"""SUMO route files: vehicle types, routes, vehicles, trips and flows become entries of a scenario's traffic.

What is left out has SUMO's defaults. Elements without effect on the drive are noted; all others are refused by line.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from math import inf
from typing import Any

from drivecal.bundles.traffic.departures import LONG, Clock, Stream, seconds
from drivecal.bundles.traffic.elements import Element, Notes, finite, read_tree
from drivecal.bundles.traffic.entries import Entry, VehicleNames
from drivecal.bundles.traffic.routes import LongSearchError, WaySearch
from drivecal.bundles.traffic.vehicle_types import VehicleTypes, check_attributes
from drivecal.contracts.input_errors import nearest
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError
from drivecal.roads.network import Network

MOST_VEHICLES = 2000
SHORTEST = 1e-6
"""Seconds between two vehicles of a flow."""
MOST_WAYS = 100
"""Different ways of trips, which are searched for."""
ARRIVAL = {"arrivalPos": "max", "arrivalSpeed": "current", "arrivalLane": "current", "arrivalPosLat": ""}
"""SUMO's default of each attribute that decides how a vehicle leaves, at the end of its route."""
VEHICLE = frozenset({"type", "depart", "departLane", "departPos", "departSpeed", "route", "from", "to", "via", *ARRIVAL})
FLOW = (VEHICLE - {"depart"}) | {"begin", "end", "number", "vehsPerHour", "perHour", "period", "probability"}
LANES = ("first", "best", "allowed", "free", "random")
PLACES = ("base", "last", "free", "random", "random_free")
SPEEDS = ("max", "desired", "avg", "last", "speedLimit", "random")
PEOPLE = ("person", "personFlow", "container", "containerFlow")
_RATE = re.compile(r"exp\(([^()]*)\)")


class RouteFile:
    """The traffic of a route file."""

    def __init__(self, content: bytes, name: str, network: Network, clock: Clock, names: VehicleNames, seed: int) -> None:
        """Reads a file. `name`: the file's; `names`: of all vehicles; `seed`: draws the types of vehicles from distributions.

        Raises InvalidInputError, also if none of the file's vehicles belongs to the run.
        """
        self._root = read_tree(content, name, "routes")
        self._network, self._clock, self._names = network, clock, names
        self._notes = Notes(name)
        self._types = VehicleTypes(seed, self._notes)
        self._routes: dict[str, Element] = {}
        self._ways: dict[tuple[str, ...], list[str] | None] = {}
        self._searched = WaySearch(network)
        self._count = self._early = 0
        self._from, self._to = inf, -inf
        self.entries: list[Entry] = []
        for element in self._root.children:
            self._take(element)
        if not self.entries:
            raise self._empty()
        self.notes = self._notes.texts(self._root)
        if self._early:
            early = f"{self._early:,} of {self._count:,} vehicles, trips and flows depart before {_time(clock.first)} s"
            self.notes += (f"{name}: {early}, and are left out",)

    def _empty(self) -> InvalidInputError:
        """Returns the refusal of a file that brings no vehicle into the run."""
        if not self._count:
            return self._root.fault("it has no vehicle, trip or flow", "give one, or leave `routes` out")
        times = f"from {_time(self._from)} to {_time(self._to)} s" if self._to > self._from else f"at {_time(self._from)} s"
        message = (
            f"none of its {self._count:,} vehicles, trips and flows departs in the run, which is from {_time(self._clock.first)} to "
            f"{_time(self._clock.end)} s: they depart {times}"
        )
        return self._root.fault(message, f"give the scenario `begin: {_time(self._from)}`, the file's time at the run's begin")

    def _take(self, element: Element) -> None:
        kind = element.element
        if kind in {"vType", "vTypeDistribution"}:
            self._types.add(element)
        elif kind == "route":
            element.is_read = True
            _named(self._routes, element)
        elif kind in {"vehicle", "trip", "flow"}:
            element.is_read = True
            self._vehicle(element)
        elif kind not in PEOPLE:
            remedy = "give vType, vTypeDistribution, route, vehicle, trip and flow"
            raise element.fault("the element is not supported", remedy)

    def _vehicle(self, element: Element) -> None:
        """Adds the entries of a vehicle, trip or flow."""
        clock, is_flow = self._clock, element.element == "flow"
        begin = seconds(element, "begin", 0.0) if is_flow else max(seconds(element, "depart", None), 0.0)
        self._count += 1
        last = seconds(element, "end", begin) if is_flow else begin
        self._from, self._to = min(self._from, max(begin, 0.0)), max(self._to, last)
        if begin >= clock.end:
            element.skip()
            self._notes.add(element, f"it begins after the run's end at {_time(clock.end)} s, and is left out")
            return
        if begin < clock.first and not is_flow:
            element.skip()
            self._early += 1
            return
        check_attributes(element, FLOW if is_flow else VEHICLE)
        _check_stops(element)
        _check_arrival(element)
        if is_flow:
            self._flow(element, begin)
            return
        driver = self._types.driver(self._types.drawn(element, element.text("id")), element)
        edges, start = self._edges(element), _start(element, driver["length"])
        base = driver | {"id": self._name(element.text("id"), element), "edge": edges[0], "route": edges}
        # After a warm-up the road is not empty: SUMO looks for a place if the file names none.
        is_there = begin == clock.begin and (clock.warm_up == 0.0 or not isinstance(start["s"], str))
        if is_there and (placed := self._placed(start, edges[0], driver["length"])):
            self.entries.append(Entry("traffic", base | placed, element))
        else:
            self.entries.append(Entry("flows", base | start | self._alone(begin), element))

    def _flow(self, element: Element, begin: float) -> None:
        """Adds the entries of a flow: itself, or if its type is a distribution, its vehicles or a flow for each type."""
        clock, name = self._clock, element.text("id")
        whole = self._stream(element, begin)
        stream = whole.after(clock.first)
        if stream is None:
            element.skip()
            self._early += 1
            return
        if stream.begin >= clock.end:
            element.skip()
            self._notes.add(element, "none of its vehicles departs in the run")
            return
        if stream.random and stream.number != whole.number:
            self._notes.add(element, f"its number is less the mean of those before {_time(clock.first)} s")
        shares = self._types.shares(element)
        drivers = {kind: self._types.driver(kind, element) for kind in shares}
        edges = self._edges(element)

        def add(vehicle: str, kind: str, amount: dict[str, Any]) -> None:
            driver = drivers[kind]
            base = driver | {"id": self._name(vehicle, element), "edge": edges[0], "route": edges} | amount
            self.entries.append(Entry("flows", base | _start(element, driver["length"]), element))

        if len(shares) == 1:
            add(name, next(iter(shares)), self._amount(stream))
        elif not stream.random:
            for index, time in whole.departures(clock.first, clock.end):
                vehicle = f"{name}.{index}"
                add(vehicle, self._types.drawn(element, vehicle), self._alone(time))
        elif stream.number is None:  # flows at random with shares of a rate are a flow whose vehicles have a type at random
            for kind, share in shares.items():
                add(f"{name}.{kind}", kind, self._amount(replace(stream, per_hour=share * stream.per_hour)))
        else:
            message = "its vehicles come at random and have a distribution of types, for each of which its number is not known"
            raise element.fault(message, "give `end` instead of `number`, or a single vType")

    def _name(self, name: str, element: Element) -> str:
        """Returns the id of a new entry. Raises InvalidInputError if there are too many."""
        if len(self.entries) == MOST_VEHICLES:
            message = f"the file has more than {MOST_VEHICLES:,} vehicles, trips and flows until the scenario's end"
            raise element.fault(
                message, "leave out vehicles that are never met, make flows of them, or give a shorter `warm_up`"
            )
        return self._names.new(name, element)

    def _alone(self, begin: float) -> dict[str, Any]:
        """Returns the amount of a single vehicle. `begin`: time of the file."""
        return {"begin": max(self._clock.shifted(begin), -self._clock.warm_up), "per_hour": 3600.0, "number": 1}

    def _amount(self, stream: Stream) -> dict[str, Any]:
        """Returns how many vehicles a flow has, and when they come in the run."""
        shifted = self._clock.shifted
        amount = {"number": stream.number, "end": None if stream.end is None else shifted(stream.end)}
        amount |= {"begin": shifted(stream.begin), "per_hour": stream.per_hour}
        return amount | ({"random": True} if stream.random else {})

    def _edges(self, element: Element) -> list[str]:
        """Returns the edges of a vehicle's route."""
        inner = element.optional("route")
        if inner is not None or "route" in element.values:
            name = element.text("route", "")
            route = self._routes.get(name) if inner is None else inner
            if route is None:
                raise element.fault(f"there is no route {shown(name)} before it", nearest(name, list(self._routes)))
            check_attributes(route, {"edges"})
            _check_stops(route)
            edges = route.text("edges").split()
            if not edges:
                raise route.fault("the route has no edges", "give it edges")
            return self._known(route, edges)
        stops = [element.text("from"), *element.text("via", "").split(), element.text("to")]
        stops = self._known(element, stops)
        if tuple(stops) not in self._ways:
            if len(self._ways) == MOST_WAYS:
                raise element.fault(f"the trips have more than {MOST_WAYS} different ways", "give routes instead of trips")
            try:
                self._ways[tuple(stops)] = self._searched.over(stops)
            except LongSearchError:
                message = "the ways of the trips take too long to be searched in this network"
                raise element.fault(message, "give routes instead of trips, or a smaller network") from None
        way = self._ways[tuple(stops)]
        if way is None:
            raise element.fault(f"no way leads over {', '.join(map(shown, stops))}", "give a route")
        return way

    def _known(self, element: Element, edges: list[str]) -> list[str]:
        for edge in edges:
            if edge not in self._network.edges or self._network.edges[edge].function != "":
                roads = [name for name in self._network.edges if not name.startswith(":")]
                raise element.fault(f"the network has no edge {shown(edge, 80)}", nearest(edge, roads))
        return edges

    def _placed(self, start: Mapping[str, Any], edge: str, length: float) -> dict[str, Any] | None:
        """Returns the place of a vehicle that is there from the start, None if SUMO must look for one."""
        lanes = self._network.edges[edge].lanes
        lane, s, speed = start["lane"], start["s"], start["speed"]
        if lane == "first":
            lane = next((entry.index for entry in lanes if entry.for_cars), 0)
        if isinstance(lane, str) or lane >= len(lanes) or isinstance(speed, str):
            return None
        if s == "base":
            s = 0.5 * length
        return None if isinstance(s, str) or s > lanes[lane].length else {"lane": lane, "s": s, "speed": speed}

    def _stream(self, element: Element, begin: float) -> Stream:
        """Returns how many vehicles a flow has, and when they come."""
        given = [key for key in ("vehsPerHour", "perHour", "period", "probability") if key in element.values]
        end = seconds(element, "end", None) if "end" in element.values else None
        number = element.integer("number", 1, 10_000) if "number" in element.values else None
        if len(given) > 1:
            raise element.fault(f"it has {' and '.join(given)}", "give one of them")
        if not given:
            if number is None or end is None or end <= begin:
                raise element.fault("how many vehicles come is not said", "give vehsPerHour, period, or number, begin and end")
            return Stream(begin, end, number, number * 3600.0 / max(end - begin, SHORTEST))
        key = given[0]
        if key == "period" and (match := _RATE.fullmatch(element.text("period").replace(" ", ""))):
            rate = finite(match[1])
            if rate is None or not 1.0 / LONG <= rate <= 1.0 / SHORTEST:
                raise element.fault(f"period is {shown(element.text('period'))}, which is not a rate", "give e.g. exp(0.2)")
            return Stream(begin, end, number, 3600.0 * rate, random=True)
        value = element.number(key, SHORTEST, 1.0 if key == "probability" else LONG)
        if key == "probability":
            self._notes.add(element, "vehicles come at random with the same mean, but at any time instead of once a second")
            return Stream(begin, end, number, 3600.0 * value, random=True)
        return Stream(begin, end, number, 3600.0 / value if key == "period" else value)


def _named(table: dict[str, Element], element: Element) -> None:
    name = element.text("id")
    if name in table:
        raise element.fault("another one has the same id", "rename one")
    table[name] = element


def _check_arrival(element: Element) -> None:
    """Raises InvalidInputError for a vehicle that leaves elsewhere than at the end of its last edge, or in another way than it comes."""
    for key, default in ARRIVAL.items():
        if (text := element.text(key, default)) != default:
            remedy = f"give {default}, or leave it out" if default else "leave it out"
            raise element.fault(f"{key} is {shown(text, 40)}, but vehicles drive on to the end of their route", remedy)


def _check_stops(element: Element) -> None:
    for stop in element.every("stop"):
        raise stop.fault("stops are not supported", "leave the stop out")


def _start(element: Element, length: float) -> dict[str, Any]:
    """Returns lane, place and speed at which a vehicle departs, as numbers or SUMO's words: `departPos` is that of its front."""
    lane: int | str = element.text("departLane", "first")
    if lane not in LANES:
        lane = element.integer("departLane", 0, 30)
    place, speed = (
        text if (text := element.text(key, default)) in words else element.number(key, 0.0, LONG, finite(default))
        for key, words, default in (("departPos", PLACES, "base"), ("departSpeed", SPEEDS, "0"))
    )
    if not isinstance(place, str):
        place = place - 0.5 * length if place > 0.5 * length else "base"
    return {"lane": lane, "s": place, "speed": speed}


def _time(value: float) -> str:
    """Returns a time (s) as it is written in files and manifests."""
    return f"{value:.12g}"

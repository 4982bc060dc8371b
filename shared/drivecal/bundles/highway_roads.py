"""Roads of the simulator `highway`: converts OpenDRIVE files of a bundle, and checks that each scenario fits its network.

A converted network is a file of the archive (`road.xodr.net.xml`), next to its OpenDRIVE file. Vehicles drive on the network, so it counts
in digests like every other file. It names the digest of its source: a network that is older than its source is refused.
"""

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import chain, islice, pairwise

from drivecal.bundles.archives import BundleFile
from drivecal.bundles.highway import FARTHEST, Described, HighwayScenario, HighwaySimulator, Placed, TaskScenario, TrafficEntry
from drivecal.bundles.highway_checks import declared_scenario, scenario_problems
from drivecal.bundles.manifest import Manifest
from drivecal.bundles.traffic.description import Description, described, map_of, network_of, with_origin
from drivecal.bundles.traffic.entities import Files
from drivecal.bundles.traffic.places import Map
from drivecal.contracts.input_errors import nearest
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem, T, attempted, problems_of, restated
from drivecal.domain.roads import Road
from drivecal.roads.carriageway import carriageway
from drivecal.roads.conversion import converted
from drivecal.roads.corridor import Corridor, corridor
from drivecal.roads.network import Network, network_file, source_of

SHORTEST_DRIVE = 0.5
"""Share of the way at start speed that a route must have at least."""
MOST_SECONDS = 120.0
"""Limit of a core's time for files and routes of scenarios: a server reads one push at a time, and a route takes up to a second."""
Driven = tuple[str, tuple[str, ...], float, bool]
"""Network, route and limit of lanes without one (m/s, 0 without it) of a scenario: what its corridor depends on."""
LARGEST_JUMP = 2.0
"""Metres between two lanes that SUMO's vehicles may skip without a note."""


def conversions(manifest: Manifest, files: Mapping[str, BundleFile]) -> tuple[dict[str, bytes], tuple[str, ...]]:
    """Returns the networks to add to a bundle, by file, and notes on them. A network that was made of the same file is kept.

    Raises InvalidInputError if a file cannot be converted, and UnavailableError if netconvert is missing.
    """
    networks: dict[str, bytes] = {}
    notes: list[str] = []
    problems: list[Problem] = []
    opened = files_read(files)
    for field, scenario in _scenarios(manifest):
        name = attempted(network_of, scenario, opened)
        if isinstance(name, InvalidInputError):
            problems += _prefixed(name, field)
            continue
        if not name.lower().endswith(".xodr") or name not in files or network_file(name) in networks:
            continue
        existing = files.get(network_file(name))
        if existing is not None:
            if source_of(existing.content) != _digest(files[name]):
                problems.append(_stale(field, name))
            continue
        conversion = attempted(converted, files[name].content, name)
        problems += [Problem(f"{field}.network", _message(problem), problem.remedy) for problem in problems_of(conversion)]
        if not isinstance(conversion, InvalidInputError):
            networks[network_file(name)] = conversion.network
            notes += [f"{name}: {note}" for note in conversion.notes]
    if problems:
        raise InvalidInputError(*dict.fromkeys(problems))
    return networks, tuple(notes)


def check_roads(manifest: Manifest, files: Mapping[str, BundleFile]) -> tuple[str, ...]:
    """Returns what the files of scenarios say and is ignored, and notes on each route that ends before its scenario's duration, at the
    ego vehicle's start speed, or on which SUMO's vehicles jump.

    Raises InvalidInputError if a scenario's files, network, route or positions do not fit each other, with the fields of the manifest.
    """
    roads = _Roads(files)
    problems: dict[str, list[Problem]] = dict(_roads_of_tasks(manifest, roads, files))
    descriptions: dict[str, Description] = {}
    for field, scenario in _scenarios(manifest):
        roads.check_time()
        problems[field] = []
        try:
            descriptions[field] = description = described(scenario, roads.files, roads.map, _step(manifest))
        except InvalidInputError as error:
            problems[field] += _prefixed(error, field)
        else:
            if description.scenario is not scenario or description.routes is not None:
                problems[field] += _located(description, field, _again(description, field, manifest))
    notes: dict[str, list[str]] = {field: [] for field in descriptions}
    by_road = sorted(descriptions.items(), key=lambda entry: _road(entry[1].scenario))  # each network and route is read once
    for field, description in by_road:
        roads.check_time()
        problems[field] += _located(description, field, _problems(roads, field, description.scenario))
        if not problems[field]:
            notes[field] += _notes(roads.corridor(description.scenario), field, description.scenario)
    if any(problems.values()):
        raise InvalidInputError(*dict.fromkeys(chain.from_iterable(problems.values())))
    ignored = chain.from_iterable(description.notes for description in descriptions.values())
    return (*dict.fromkeys(ignored), *chain.from_iterable(notes.values()))


def _roads_of_tasks(
    manifest: Manifest, roads: "_Roads", files: Mapping[str, BundleFile]
) -> Iterator[tuple[str, list[Problem]]]:
    """Yields the faults of the roads of scenarios with a task, whose lanes are equal and go from the begin to the end."""
    for name, data in manifest.scenarios.items():
        scenario = declared_scenario(data)
        if isinstance(scenario, TaskScenario) and scenario.network in files:
            roads.check_time()
            field = f"scenarios.{name}"
            road = attempted(carriageway, files[scenario.network].content, tuple(scenario.route), scenario.network)
            yield field, list(_starts(scenario, road, field) if isinstance(road, Road) else _prefixed(road, field))


def _starts(scenario: TaskScenario, road: Road, field: str) -> Iterator[Problem]:
    """Yields the lanes that the road does not have, and vehicles that start off the road, inside of each other, or, under some seed, beyond
    an end of the road."""
    ego, task = scenario.ego, scenario.task
    wanted = {"task.start_lane": task.start_lane, "task.target_lane": task.target_lane}
    wanted |= {f"traffic[{index}].lane": other.lane for index, other in enumerate(scenario.traffic)}
    for place, lane in wanted.items():
        if lane >= road.lanes:
            yield Problem(
                f"{field}.{place}", f"lane {lane}, but the road has {road.lanes} lanes", f"give 0 to {road.lanes - 1}"
            )
    for place, value, least, most in (("s", ego.s, 0.0, road.length), ("d", ego.d, road.right_edge, road.left_edge)):
        if not least <= value <= most:
            yield Problem(f"{field}.ego.{place}", f"{value:g} m is off the road", f"give {least:g} to {most:.2f}")
    starts = [("ego", ego.s, ego.d, ego.length, ego.width)]
    for index, other in enumerate(scenario.traffic):
        reach = FARTHEST * other.departure_deviation * other.speed
        last = road.length - reach - 0.5 * other.length
        if not reach <= other.s <= last:
            message = f"{other.id} starts at {other.s - reach:g} to {other.s + reach:g} m of a road of {road.length:.2f} m"
            yield Problem(f"{field}.traffic[{index}].s", message, f"give {reach:g} to {last:.2f}")
        offset = other.lane * road.lane_width
        for name, s, d, length, width in starts:
            if 2 * abs(s - other.s) < length + other.length and 2 * abs(d - offset) < width + other.width:
                message = f"{other.id} starts inside of {name}"
                yield Problem(f"{field}.traffic[{index}].s", message, "place them farther apart")
        starts.append((other.id, other.s, offset, other.length, other.width))


def _notes(road: Corridor, field: str, scenario: HighwayScenario) -> Iterator[str]:
    """Yields notes on a route that is shorter than the drive at start speed, and on its longest gap between lanes."""
    ego, ahead = scenario.ego, road.length - _start(road, scenario)
    if ahead < ego.speed * scenario.duration:
        yield f"{field}: at {ego.speed:g} m/s the route ends after {ahead / ego.speed:.1f} of {scenario.duration:g} s"
    jumps = [
        (road.places[after.edge, after.index].item(0, 1) - road.places[before.edge, before.index].item(-1, 1), before.edge)
        for track in road.tracks
        for before, after in pairwise(track.lanes)
    ]
    longest, edge = max(jumps, default=(0.0, ""))
    if longest > LARGEST_JUMP:
        yield (
            f"{field}: the network has no lanes inside of junctions, and SUMO's vehicles jump over {longest:.1f} m behind the edge "
            f"{shown(edge, 80)}; build it again without --no-internal-links"
        )


def _again(description: Description, field: str, manifest: Manifest) -> Iterator[Problem]:
    """Yields the faults of a scenario whose files have been read."""
    others = frozenset[str]() if description.routes is None else description.routes.vehicles
    return scenario_problems(field, description.scenario, _step(manifest), is_whole=True, others=others)


def _located(description: Description, field: str, problems: Iterator[Problem]) -> Iterator[Problem]:
    """Yields problems with the fields of files for what files describe."""
    for problem in problems:
        place = with_origin(replace(problem, field=problem.field.removeprefix(f"{field}.")), description.origins)
        yield replace(place, field=f"{field}.{place.field}")


def _step(manifest: Manifest) -> float:
    """Returns the simulator's step (s)."""
    return manifest.simulator.step if isinstance(manifest.simulator, HighwaySimulator) else 0.1


class _Roads:
    """Networks of a bundle, each read once, and the corridor of the last scenario: all corridors might not fit into memory."""

    def __init__(self, files: Mapping[str, BundleFile]) -> None:
        self._files = files
        self._began = time.thread_time()
        self.files = files_read(files, self.check_time)
        self._maps: dict[str, Map | InvalidInputError] = {}
        self._last: tuple[Driven, Corridor | InvalidInputError] | None = None

    def check_time(self) -> None:
        """Raises InvalidInputError if reading files and measuring routes takes too long."""
        if time.thread_time() - self._began > MOST_SECONDS:
            message = f"their files and routes take more than {MOST_SECONDS:g} s of a core to be read"
            remedy = "give more scenarios the same route, smaller files, or push several problems"
            raise InvalidInputError(Problem("scenarios", message, remedy))

    def map(self, name: str) -> Map:
        """Returns a network of the bundle with its OpenDRIVE file. Raises InvalidInputError with the field `network`."""
        if name not in self._maps:
            self._maps[name] = attempted(self._read, name)
        return _made(self._maps[name])

    def corridor(self, scenario: HighwayScenario) -> Corridor:
        """Returns the corridor of a scenario. Raises InvalidInputError."""
        key = _road(scenario)
        if self._last is None or self._last[0] != key:
            self._last = None  # before the next is made
            self._last = key, attempted(self._measured, scenario)
        return _made(self._last[1])

    def _measured(self, scenario: HighwayScenario) -> Corridor:
        network = self.map(scenario.network).network
        return corridor(network, scenario.route, scenario.network, scenario.default_limit, crossings=scenario.crossings)

    def _read(self, name: str) -> Map:
        file = self._files.get(network_file(name))
        if file is None:
            message = f"the archive has no {shown(network_file(name), 300)}, the network that is made of {shown(name, 300)}"
            raise InvalidInputError(Problem("network", message, "push the folder: drivecal problem push DIR"))
        source = self._files.get(name)
        if name != network_file(name) and (source is None or source_of(file.content) != _digest(source)):
            raise InvalidInputError(replace(_stale("", name), field="network"))
        with restated(lambda problem: replace(problem, field="network", message=_message(problem))):
            return map_of(self.files.read, name, self.check_time)


def _made(part: T | InvalidInputError) -> T:
    if isinstance(part, InvalidInputError):
        raise part
    return part


def _problems(roads: _Roads, field: str, scenario: HighwayScenario) -> Iterator[Problem]:
    try:
        network, road = roads.map(scenario.network).network, roads.corridor(scenario)
    except InvalidInputError as error:
        yield from _prefixed(error, field)
        return
    start = attempted(_start, road, scenario)
    if isinstance(start, InvalidInputError):
        yield from _prefixed(start, f"{field}.ego")
    elif road.length - start < SHORTEST_DRIVE * scenario.ego.speed * scenario.duration:
        message = f"the route ends {road.length - start:.0f} m after the start, too short for {scenario.duration:g} s"
        yield Problem(f"{field}.route", message, "give a longer route, or a shorter duration")
    for index, vehicle in enumerate(scenario.traffic):
        yield from _vehicle(network, road, vehicle, f"{field}.traffic[{index}]")


def _start(road: Corridor, scenario: HighwayScenario) -> float:
    """Returns s of the ego vehicle's start. Raises InvalidInputError with the fields of a place."""
    ego: Placed = scenario.ego
    if ego.edge is not None:
        return road.position(ego.edge, ego.lane, ego.s)[0]
    road.piece(ego.s, ego.lane)
    return ego.s


def _vehicle(network: Network, road: Corridor, vehicle: TrafficEntry, field: str) -> Iterator[Problem]:
    """Yields the faults of a vehicle's place and route; a path has neither."""
    if vehicle.path is not None:
        return
    for index, message, remedy in islice(network.faults(vehicle.route or ()), 1):  # names of 2,000 roads are compared for each
        yield Problem(f"{field}.route[{index}]", f"{network.name}: {message}", remedy)
    if vehicle.edge is None:
        piece = attempted(road.piece, vehicle.s, vehicle.lane)
        if isinstance(piece, InvalidInputError):
            yield from _prefixed(piece, field)
        elif vehicle.route is not None and piece.edge not in vehicle.route:
            message = f"the vehicle starts on {shown(piece.edge, 80)}, which is not on its route"
            yield Problem(f"{field}.route", message, "give a route with this edge, or another s")
        return
    edge = network.edges.get(vehicle.edge)
    for _, message, remedy in network.faults([vehicle.edge]):
        yield Problem(f"{field}.edge", f"{network.name}: {message}", remedy)
    if edge is not None and edge.function == "" and vehicle.lane >= len(edge.lanes):
        message = f"the edge {shown(edge.id, 80)} has no lane {vehicle.lane}"
        yield Problem(f"{field}.lane", message, f"give 0 to {len(edge.lanes) - 1}")
    if edge is not None and vehicle.lane < len(edge.lanes) and vehicle.s > edge.lanes[vehicle.lane].length:
        length = edge.lanes[vehicle.lane].length
        message = f"the lane {shown(f'{edge.id}_{vehicle.lane}', 90)}, {length:.2f} m long, has no position {vehicle.s:g} m"
        yield Problem(f"{field}.s", message, f"give 0 to {length:.2f}")
    if edge is not None and vehicle.route is not None and edge.id not in vehicle.route:
        yield Problem(f"{field}.edge", f"{shown(edge.id, 80)} is not on its own route", "give an edge of `route`")


def _scenarios(manifest: Manifest) -> Iterator[tuple[str, Described]]:
    for name, data in manifest.scenarios.items():
        scenario = declared_scenario(data)
        if not isinstance(scenario, TaskScenario):
            yield f"scenarios.{name}", scenario


def files_read(files: Mapping[str, BundleFile], check: Callable[[], None] = lambda: None) -> Files:
    """Returns the files of a bundle for `described`. `check` is called before one is read."""

    def read(name: str) -> bytes:
        check()
        if name not in files:
            remedy = nearest(name, [other for other in files if other.endswith(name[name.rfind(".") :])])
            raise InvalidInputError(Problem(name, "the folder of the problem has no such file", remedy))
        return files[name].content

    return Files(frozenset(files), read)


def _road(scenario: HighwayScenario) -> Driven:
    return scenario.network, tuple(scenario.route), scenario.default_limit or 0.0, scenario.crossings


def _prefixed(error: InvalidInputError, field: str) -> Iterator[Problem]:
    for problem in error.problems:
        yield replace(problem, field=f"{field}.{problem.field}")


def _message(problem: Problem) -> str:
    return f"{problem.field}: {problem.message}"


def _digest(file: BundleFile) -> str:
    return hashlib.sha256(file.content).hexdigest()


def _stale(field: str, name: str) -> Problem:
    message = f"{shown(network_file(name), 300)} was not made of this {shown(name, 300)}"
    return Problem(f"{field}.network", message, f"delete {shown(network_file(name), 300)}; it is made again")

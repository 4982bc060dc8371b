"""The description of a scenario of kind `highway` that its files complete: route files and OpenSCENARIO files become entries of YAML."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from drivecal.bundles.highway import Declared, HighwayScenario, OpenScenario
from drivecal.bundles.highway_checks import declared_scenario
from drivecal.bundles.traffic.departures import Clock
from drivecal.bundles.traffic.elements import refusal
from drivecal.bundles.traffic.entities import Files
from drivecal.bundles.traffic.entries import Entry, VehicleNames
from drivecal.bundles.traffic.openscenario import ScenarioFile
from drivecal.bundles.traffic.places import Map
from drivecal.bundles.traffic.route_files import RouteFile
from drivecal.contracts.input_errors import validated
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.roads.corridor import corridor
from drivecal.roads.limits import FIELD
from drivecal.roads.network import network_file, read_network
from drivecal.roads.opendrive import read_opendrive

_ENTRY = re.compile(r"\w+\[\d+\]")
Maps = Callable[[str], Map]
"""Returns the map of a network by its file's name; raises InvalidInputError with the field `network`."""


@dataclass(frozen=True, slots=True)
class Description:
    """A scenario with everything that its files say. `notes`: what they say and is ignored; `origins`: their entries by field."""

    scenario: HighwayScenario
    notes: tuple[str, ...] = ()
    origins: Mapping[str, Problem] = field(default_factory=dict)

    def located(self, problem: Problem) -> Problem:
        """Returns a problem of an entry of a file with the file's field, and line and element in the message."""
        return _with_origin(problem, self.origins)


def network_of(scenario: Declared, files: Files) -> str:
    """Returns the path of a scenario's network in the bundle. Raises InvalidInputError with the field `openscenario`."""
    if isinstance(scenario, HighwayScenario):
        return scenario.network
    try:
        return ScenarioFile(scenario, files).network
    except InvalidInputError as error:
        raise _located(error, scenario) from error


def described(scenario: Declared, files: Files, maps: Maps, step: float) -> Description:
    """Returns a scenario with the traffic of its files. `step`: the simulator's (s).

    Raises InvalidInputError with the fields of the scenario; the messages have file, line and element.
    """
    if isinstance(scenario, HighwayScenario) and scenario.routes is None:
        return Description(scenario)
    names = VehicleNames([*(vehicle.id for vehicle in scenario.traffic), *(flow.id for flow in scenario.flows)])
    document = scenario.model_dump(exclude_none=True, exclude={"routes", "begin", "openscenario", "parameters", "ego"})
    entries: list[tuple[str, Entry]] = []
    notes: tuple[str, ...] = ()
    network = network_of(scenario, files)
    roads = maps(network)
    document |= {"network": network}
    if isinstance(scenario, OpenScenario):
        limit = scenario.default_limit
        try:
            file = ScenarioFile(scenario, files)
            content, vehicles = file.described(roads, lambda route: corridor(roads.network, route, network, limit), step, names)
        except InvalidInputError as error:
            raise _located(error, scenario) from error
        document, notes = document | content, file.notes
        entries += [("openscenario", entry) for entry in vehicles]
    else:
        document["ego"] = scenario.ego.model_dump(exclude_none=True)
    if scenario.routes is not None:
        clock = Clock(scenario.begin, scenario.warm_up, document["duration"])
        try:
            opened = files.read(scenario.routes)
            routes = RouteFile(opened, scenario.routes, roads.network, clock, names, scenario.seed)
        except InvalidInputError as error:
            raise refusal(error, "routes") from error
        notes += routes.notes
        entries += [("routes", entry) for entry in routes.entries]
    origins: dict[str, Problem] = {}
    for key, entry in entries:
        section = document.setdefault(entry.section, [])
        element = entry.element
        place = element.fault("", "").problems[0]
        origins[f"{entry.section}[{len(section)}]"] = Problem(key, f"{element.file}: {place.message.removesuffix(': ')}")
        section.append({key: value for key, value in entry.document.items() if value is not None})
    try:
        complete = validated(HighwayScenario, document)
    except InvalidInputError as error:
        raise InvalidInputError(*(_with_origin(problem, origins) for problem in error.problems)) from error
    return Description(complete, notes, origins)


def described_in(folder: Path, data: Mapping[str, Any], step: float) -> HighwayScenario:
    """Returns the scenario of an unpacked bundle. Raises InvalidInputError."""

    def read(name: str) -> bytes:
        return (folder / name).read_bytes()

    names = frozenset(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    return described(declared_scenario(data), Files(names, read), lambda name: map_of(read, name), step).scenario


def map_of(read: Callable[[str], bytes], name: str) -> Map:
    """Returns the map of a network, whose file is read by `read`. Raises InvalidInputError."""
    network = read_network(read(network_file(name)), name)
    return Map(network, (lambda: read_opendrive(read(name), name)) if name != network_file(name) else None)


def _with_origin(problem: Problem, origins: Mapping[str, Problem]) -> Problem:
    entry = _ENTRY.match(problem.field)
    origin = origins.get(entry[0]) if entry is not None else None
    if origin is None:
        return problem
    detail = problem.field[len(entry[0]) :].lstrip(".") if entry is not None else ""
    message = ": ".join(filter(None, (origin.message, detail, problem.message)))
    return replace(problem, field=origin.field, message=message)


def _located(error: InvalidInputError, scenario: OpenScenario) -> InvalidInputError:
    """Returns an error with fields of the scenario: faults in the file belong to `openscenario`."""
    own = {"ego", FIELD} | {f"parameters.{name}" for name in scenario.parameters}
    inner = [problem for problem in error.problems if problem.field not in own]
    kept = [problem for problem in error.problems if problem.field in own]
    return InvalidInputError(*kept, *refusal(InvalidInputError(*inner), "openscenario").problems)

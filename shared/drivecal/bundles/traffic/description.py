"""The description of a scenario of kind `highway` that its files complete.

OpenSCENARIO files become entries of YAML; what a route file says is checked, and SUMO reads it.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from drivecal.bundles.highway import Declared, Described, HighwayScenario, OpenScenario, TaskScenario
from drivecal.bundles.highway_checks import declared_scenario
from drivecal.bundles.traffic.elements import in_file
from drivecal.bundles.traffic.entities import Files
from drivecal.bundles.traffic.openscenario import ScenarioFile, VehicleNames
from drivecal.bundles.traffic.places import Map
from drivecal.bundles.traffic.route_files import RouteTraffic, read_routes
from drivecal.contracts.input_errors import validated
from drivecal.domain.errors import InvalidInputError, Problem, restated
from drivecal.roads.corridor import corridor
from drivecal.roads.network import FIELD, network_file, read_network
from drivecal.roads.opendrive import read_opendrive

_ENTRY = re.compile(r"\w+\[\d+\]")
Maps = Callable[[str], Map]
"""Returns the map of a network by its file's name; raises InvalidInputError with the field `network`."""


@dataclass(frozen=True, slots=True)
class Description:
    """A scenario with everything that its files say.

    Attributes:
        scenario: The scenario, with the entries of an OpenSCENARIO file.
        notes: What the files say and is ignored.
        origins: Places in the OpenSCENARIO file by the fields of its entries.
        routes: The traffic of a route file.
    """

    scenario: HighwayScenario
    notes: tuple[str, ...] = ()
    origins: Mapping[str, Problem] = field(default_factory=dict)
    routes: RouteTraffic | None = None


def network_of(scenario: Described, files: Files) -> str:
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
    if isinstance(scenario, TaskScenario):
        raise TypeError("files do not complete a scenario with a task")
    description = Description(scenario) if isinstance(scenario, HighwayScenario) else _complete(scenario, files, maps, step)
    complete = description.scenario
    if complete.routes is None:
        return description
    network = maps(complete.network).network
    with restated(partial(in_file, place="routes")):
        content = files.read(complete.routes)
        routes = read_routes(content, complete.routes, network, complete, complete.duration)
    return replace(description, notes=description.notes + routes.notes, routes=routes)


def _complete(scenario: OpenScenario, files: Files, maps: Maps, step: float) -> Description:
    """Returns a scenario with the entries of its OpenSCENARIO file."""
    # Vehicles of the file do as they are told, and give way to none.
    crossings = not (scenario.routes or any(entry.model != "constant" for entry in scenario.traffic))
    names = VehicleNames(vehicle.id for vehicle in scenario.traffic)
    document = scenario.model_dump(exclude_none=True, exclude={"openscenario", "parameters", "ego"})
    network, limit = network_of(scenario, files), scenario.default_limit
    roads = maps(network)
    try:
        file = ScenarioFile(scenario, files)
        content, entries = file.described(
            roads, lambda route: corridor(roads.network, route, network, limit, crossings=crossings), step, names
        )
    except InvalidInputError as error:
        raise _located(error, scenario) from error
    document |= {"network": network, "crossings": crossings} | content
    origins: dict[str, Problem] = {}
    for entry in entries:
        section = document.setdefault("traffic", [])
        element = entry.element
        place = element.fault("", "").problems[0]
        message = f"{element.file}: {place.message.removesuffix(': ')}"
        origins[f"traffic[{len(section)}]"] = Problem("openscenario", message)
        section.append({key: value for key, value in entry.document.items() if value is not None})
    with restated(lambda problem: with_origin(problem, origins)):
        complete = validated(HighwayScenario, document)
    return Description(complete, file.notes, origins)


def described_in(folder: Path, data: Mapping[str, Any], step: float) -> Description:
    """Returns the description of a scenario of an unpacked bundle. Raises InvalidInputError."""

    def read(name: str) -> bytes:
        return (folder / name).read_bytes()

    names = frozenset(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    return described(declared_scenario(data), Files(names, read), lambda name: map_of(read, name), step)


def map_of(read: Callable[[str], bytes], name: str, check_time: Callable[[], None] = lambda: None) -> Map:
    """Returns the map of a network, whose file is read by `read`. `check_time`: see Map. Raises InvalidInputError."""
    is_converted = name != network_file(name)
    network = read_network(read(network_file(name)), f"the network that netconvert makes of {name}" if is_converted else name)
    return Map(network, (lambda: read_opendrive(read(name), name)) if is_converted else None, check_time)


def with_origin(problem: Problem, origins: Mapping[str, Problem]) -> Problem:
    """Returns a problem of an entry of a file with the file's field, and line and element in the message."""
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
    return InvalidInputError(*kept, *(in_file(problem, "openscenario") for problem in inner))

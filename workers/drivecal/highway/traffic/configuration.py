"""SUMO's route file of a scenario, and the ways of drifting vehicles."""

from itertools import pairwise
from xml.etree.ElementTree import Element, ParseError, SubElement, fromstring, tostring

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.scenarios import Scenario, TrafficVehicle
from drivecal.highway.sumo import EGO

ROUTE = "road"


def edges(network: bytes, lanes: int) -> list[str]:
    """Returns the names of a network's edges in the direction of travel.

    Raises InvalidInputError unless they form one carriageway with `lanes` lanes: SUMO itself can crash on a damaged network.
    """
    try:
        root = fromstring(network)  # noqa: S314  # expat expands no external entities, its own limits stop the rest
    except ParseError as error:
        raise _refused(f"it is not XML ({error})") from error
    by_start = {edge.get("from"): edge for edge in root.iter("edge") if edge.get("function") is None}
    node = next(iter(set(by_start) - {edge.get("to") for edge in by_start.values()}), None)
    names = []
    while node in by_start:
        edge = by_start.pop(node)
        names.append(edge.get("id", ""))
        node = edge.get("to")
        if len(edge.findall("lane")) != lanes:
            raise _refused(f"edge {names[-1]} does not have {lanes} lanes")
    if by_start or not names:
        raise _refused("its edges do not form one carriageway")
    return names


def _refused(message: str) -> InvalidInputError:
    return InvalidInputError(Problem("network", message, "build it from the scenario's road"))


def routes(scenario: Scenario) -> bytes:
    """Returns the route file: one route over the whole road, one vehicle type per vehicle, no vehicles (each run adds them).

    Raises InvalidInputError like `edges`.
    """
    root = Element("routes")
    SubElement(root, "route", id=ROUTE, edges=" ".join(edges(scenario.network, scenario.road.lanes)))
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

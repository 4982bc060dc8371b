"""SUMO's route file of a scenario, and the ways of drifting vehicles."""

from itertools import pairwise
from xml.etree.ElementTree import Element, SubElement, tostring

from drivecal.domain.scenarios import Scenario, TrafficVehicle
from drivecal.highway.sumo import EGO

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

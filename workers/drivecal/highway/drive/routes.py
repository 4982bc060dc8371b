"""SUMO's route file and command line options of a scenario, and the traffic before a run.

The vehicles of a route file drive alone until the run's time 0, and those too close to a vehicle that starts then are removed. This
warm-up is simulated before each run. A state that SUMO has written would be there in a tenth of the time, but not always with the same
bits: vehicles with SL2015 go on otherwise each time that they are restored (SUMO 1.28).
"""

from collections.abc import Sequence
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from drivecal.bundles.highway import HighwayScenario, TrafficBehaviour, TrafficEntry
from drivecal.bundles.highway_actions import Brake, Wait
from drivecal.bundles.traffic.route_files import SUBLANE as SUBLANE_MODEL
from drivecal.bundles.traffic.route_files import RouteTraffic
from drivecal.domain.roads import Floats
from drivecal.highway import sumo
from drivecal.highway.geometry import hit
from drivecal.highway.sumo import EGO

RANDOM = frozenset({"EIDM", "W99"})
"""Models that are random by default."""
LANE_CHANGE_SECONDS = 3.0
"""Duration of LC2013's lane changes, which SUMO makes in one step by default."""
SUBLANE = 0.8
"""Width (m) of the strips of vehicles with SL2015."""
ANY_LIMIT = 100.0
"""Factor of the limit with which a desired speed holds whatever the limit is."""


def entries(scenario: HighwayScenario) -> dict[str, TrafficEntry]:
    """Returns vehicles by id; those without one are called `vehicle0` and so on."""
    taken = {entry.id for entry in scenario.traffic}

    def free(given: str | None, index: int) -> str:
        name = given or f"vehicle{index}"
        while given is None and name in taken:
            name += "_"
        taken.add(name)
        return name

    return {free(vehicle.id, index): vehicle for index, vehicle in enumerate(scenario.traffic)}


def is_exact(scenario: HighwayScenario) -> bool:
    """Returns whether nothing in a scenario is random and no vehicle enters later, so that vehicles can be added again for each run."""
    return scenario.routes is None and all(
        vehicle.sigma == 0.0
        and vehicle.speed_deviation == 0.0
        and vehicle.lane_change == "none"
        and vehicle.model not in RANDOM
        and not vehicle.parameters
        for vehicle in scenario.traffic
    )


def keeps_lanes(scenario: HighwayScenario, *, with_tasks: bool = False) -> bool:
    """Returns whether no vehicle of an exact scenario leaves the centre of its lane, or the route. With `with_tasks` the
    scenario has a task and need not be exact: nothing but speeds is random in it."""
    return (with_tasks or is_exact(scenario)) and all(
        vehicle.route is None
        and vehicle.path is None
        and vehicle.offset == 0.0
        and (vehicle.edge is None or vehicle.edge in scenario.route)
        and all(isinstance(action, (Brake, Wait)) for action in vehicle.actions)
        for vehicle in scenario.traffic
    )


def route_id(name: str) -> str:
    """Returns the id of a vehicle's route."""
    return f"route-{name}"


def routes_file(scenario: HighwayScenario, routes: RouteTraffic | None = None) -> bytes:
    """Returns SUMO's file of the scenario's own vehicles: a type and a route each. Each run adds the vehicles.

    `routes`: the traffic of the scenario's route file.
    """
    unmoved = SUBLANE_MODEL if SUBLANE_MODEL in _lane_changes(scenario, routes) else "LC2013"
    root = Element("routes")
    ego = scenario.ego
    SubElement(
        root, "vType", {"id": EGO, "length": repr(ego.length), "width": repr(ego.width), **_FREE} | _model(_NOBODY, unmoved)
    )
    SubElement(root, "route", id=route_id(EGO), edges=" ".join(scenario.route))
    for name, entry in entries(scenario).items():
        if entry.path is not None:
            continue
        SubElement(root, "vType", {"id": name} | _type(entry, unmoved))
        SubElement(root, "route", id=route_id(name), edges=" ".join(_route(scenario, entry)))
    return tostring(root)


_FREE = {"speedFactor": "100", "speedDev": "0", "maxSpeed": "200"}
"""Attributes with which SUMO's ego vehicle takes any speed."""
_NOBODY = TrafficBehaviour.model_validate({})


def _route(scenario: HighwayScenario, entry: TrafficEntry) -> list[str]:
    """Returns the edges that begin with the vehicle's `edge`, which alone is the route of a vehicle off the scenario's."""
    route = scenario.route if entry.route is None else entry.route
    if entry.edge is None:
        return route
    return route[route.index(entry.edge) :] if entry.edge in route else [entry.edge]


def _lane_changes(scenario: HighwayScenario, routes: RouteTraffic | None) -> frozenset[str]:
    """Returns the models of lane changes. If vehicles move in strips (SL2015), SUMO takes no other one."""
    own = frozenset(entry.lane_change for entry in scenario.traffic)
    return own if routes is None else own | routes.lane_changes


def _model(behaviour: TrafficBehaviour, unmoved: str) -> dict[str, str]:
    """Returns the names of models. `unmoved`: that of vehicles whose lane changes are switched off."""
    model = "Krauss" if behaviour.model == "constant" else behaviour.model
    lane_change = unmoved if behaviour.lane_change == "none" else behaviour.lane_change
    return {"carFollowModel": model, "laneChangeModel": lane_change, "vClass": behaviour.vehicle_class}


def _type(behaviour: TrafficBehaviour, unmoved: str) -> dict[str, str]:
    values: dict[str, float | None] = {
        "length": behaviour.length,
        "width": behaviour.width,
        "speedFactor": behaviour.speed_factor,
        "speedDev": behaviour.speed_deviation,
        "maxSpeed": behaviour.max_speed,
        "tau": behaviour.time_headway,
        "minGap": behaviour.min_gap,
        "accel": behaviour.acceleration,
        "decel": behaviour.deceleration,
        "sigma": behaviour.sigma if behaviour.model in {"Krauss", "constant"} else None,
    }
    if behaviour.desired_speed is not None:
        values |= {"maxSpeed": behaviour.desired_speed, "speedFactor": ANY_LIMIT, "speedDev": 0.0}
    values |= behaviour.parameters
    return _model(behaviour, unmoved) | {name: repr(float(value)) for name, value in values.items() if value is not None}


def options(
    scenario: HighwayScenario, network: str, route_file: str, step: float, routes: RouteTraffic | None = None
) -> list[str]:
    """Returns SUMO's command line options, without the time at which it begins. `route_file`: one, or several with commas between."""
    sideways, models = {}, _lane_changes(scenario, routes)
    if SUBLANE_MODEL in models:
        sideways = {"lateral-resolution": repr(SUBLANE)}
    elif "LC2013" in models:
        sideways = {"lanechange.duration": repr(LANE_CHANGE_SECONDS)}
    shared = sumo.options(network, route_file, step, scenario.seed)
    return shared + [text for name, value in sideways.items() for text in (f"--{name}", value)]


STANDING_GAP, HEADWAY, BRAKING, BESIDE = 2.0, 1.0, 3.0, 0.5
"""A vehicle that starts has room: 2 m and 1 s of driving of the vehicle behind, and its braking distance to the speed of the
one ahead at 3 m/s². A vehicle that is less than 0.5 m from its way has to leave it."""


def too_close(
    neighbours: Floats, outlines: Floats, starting: int, ego: Floats, outline: Floats, sideways: Sequence[float]
) -> list[int]:
    """Returns the rows of the vehicles that leave no room for a starting vehicle: the first `starting` rows, and the ego vehicle.

    `neighbours`, `outlines`: as in `drive.geometry`; `ego`, `outline`: rows of the ego vehicle of the same form; `sideways`: speeds to the
    left (m/s) of all rows. A vehicle that changes lanes is in the way at all places that it reaches until the change is done.
    """
    starts, rectangles = np.vstack([neighbours[:starting], ego]), np.vstack([outlines[:starting], outline])
    return [
        row
        for row in range(starting, len(neighbours))
        if hit(rectangles, outlines[row, :3], outlines[row, 3:5]) >= 0 or _hinders(neighbours[row], starts, sideways[row])
    ]


def _hinders(vehicle: Floats, starts: Floats, sideways: float) -> bool:
    """Returns whether a vehicle is too close to a starting vehicle, all as in `neighbours`. NaN, on another level, hinders nothing."""
    way = LANE_CHANGE_SECONDS * (sideways if vehicle[2] >= 0.0 else -sideways)  # to the left of the route
    right, left = vehicle[1] + min(way, 0.0), vehicle[1] + max(way, 0.0)
    beside = np.maximum(right - starts[:, 1], starts[:, 1] - left).clip(0.0) - 0.5 * (starts[:, 5] + vehicle[5])
    gap = np.abs(starts[:, 0] - vehicle[0]) - 0.5 * (starts[:, 4] + vehicle[4])
    is_behind = vehicle[0] < starts[:, 0]
    rear, front = np.where(is_behind, vehicle[2], starts[:, 2]), np.where(is_behind, starts[:, 2], vehicle[2])
    needed = STANDING_GAP + HEADWAY * np.maximum(rear, 0.0) + np.maximum(rear - front, 0.0) ** 2 / (2.0 * BRAKING)
    return bool(np.any((beside < BESIDE) & (gap < needed)))

"""Checks of a manifest's simulator `highway` beyond single fields."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from drivecal.bundles import units
from drivecal.bundles.highway import (
    AnyController,
    Declared,
    Described,
    FmuController,
    HighwayScenario,
    HighwaySimulator,
    OpenScenario,
    PlannerController,
    ProcessController,
    TaskScenario,
    TrafficBehaviour,
    TrafficEntry,
    TrafficVehicle,
    VehicleEntry,
)
from drivecal.bundles.highway_actions import EGO, Action, Brake, Condition, CutIn, Drift, Meet
from drivecal.bundles.highway_catalogue import (
    COMMANDS,
    FAILURES,
    MEASURES,
    PLANNER_PARAMETERS,
    SERIES,
    SIGNALS,
    TYPE_PARAMETERS,
)
from drivecal.contracts.input_errors import nearest, validated
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem, attempted, problems_of
from drivecal.domain.evaluations import Failure
from drivecal.domain.vehicles import CLOSED_LOOP_MEASURES

RELATIVE = frozenset({"gap", "headway", "ttc"})
"""Quantities between two vehicles."""
TICK = 0.01
"""Step of the vehicle's dynamics (s); all other steps are multiples of it."""
ENDINGS: Mapping[str, tuple[tuple[str, ...], str]] = {
    "network": ((".net.xml", ".xodr"), "neither a SUMO network nor an OpenDRIVE file"),
    "routes": ((".rou.xml",), "no SUMO route file"),
    "openscenario": ((".xosc",), "no OpenSCENARIO file"),
}
"""Endings of the files that scenarios name, and what others are not."""
DRIVING_FUNCTION = "frenet"
"""The built-in planner among the driving functions."""
SPLITTING = ",$"
"""Characters of a path that SUMO takes for a list of files and for variables of the environment."""
ABOVE_ZERO = frozenset({"accel", "decel", "emergencyDecel", "apparentDecel", "tau", "stepping"})
"""Attributes of vehicle types that SUMO refuses at 0 and below."""


def simulator_problems(simulator: HighwaySimulator) -> Iterator[Problem]:
    """Yields the faults of the simulator section, except in its files: `checks` reads the files of all kinds."""
    controller, step = simulator.controller, simulator.step
    period = step if controller.period is None else controller.period
    if not _is_multiple(step, TICK):
        yield Problem("simulator.step", f"{step:g} s is not a multiple of {TICK:g} s", "give e.g. 0.1")
    elif not _is_multiple(period, TICK):
        yield Problem("simulator.controller.period", f"{period:g} s is not a multiple of {TICK:g} s", "give e.g. 0.1")
    elif not _is_multiple(period, step) and not _is_multiple(step, period):
        message = f"{period:g} s is neither a multiple nor a part of the simulator's step of {step:g} s"
        yield Problem("simulator.controller.period", message, f"give e.g. {step:g}")
    yield from _outputs(controller)
    if isinstance(controller, FmuController):
        yield from _signal_table(controller)
    elif isinstance(controller, ProcessController):
        for index, name in enumerate(controller.signals or ()):
            field = f"simulator.controller.signals[{index}]"
            if name not in SIGNALS:
                yield Problem(field, f"{shown(name)} is not a signal", nearest(name, list(SIGNALS)))
            elif name in (controller.signals or ())[:index]:
                yield Problem(field, f"{name} appears twice", "give each signal once")


def _outputs(controller: AnyController) -> Iterator[Problem]:
    output = controller.output
    if len(set(output)) < len(output):
        yield Problem("simulator.controller.output", f"{output[0]} appears twice", "give each command once")
    elif {"curvature", "steering"} <= set(output):
        remedy = "leave one of them out"
        yield Problem("simulator.controller.output", "curvature and steering both steer", remedy)


def _signal_table(controller: FmuController) -> Iterator[Problem]:
    for name in controller.signals:
        if name not in SIGNALS and name not in COMMANDS:
            remedy = nearest(name, [*SIGNALS, *COMMANDS])
            yield Problem(f"simulator.controller.signals.{shown(name)}", "there is no such signal", remedy)
        elif name in COMMANDS and name not in controller.output:
            message = "the controller does not output this command"
            yield Problem(f"simulator.controller.signals.{name}", message, "add it to `output`, or leave it out")
    for name in controller.output:
        if name not in controller.signals:
            message = f"the FMU's variable for {name} is missing"
            yield Problem("simulator.controller.signals", message, f"add `{name}: VARIABLE`, the FMU's output")


def planner_problems(controller: PlannerController, parameters: Collection[str], varied: Collection[str]) -> Iterator[Problem]:
    """Yields the parameters of the built-in planner that are missing or given twice, and varied parameters that its vehicle lacks.

    Args:
        controller: the section of the planner.
        parameters: names of the problem's parameters.
        varied: names of the problem's varied parameters.
    """
    known = [name for name in VehicleEntry.model_fields if name != "model"]
    for name in varied:
        if name not in known:
            yield Problem(f"varied.{name}", "the planner's vehicle has no such parameter", nearest(name, known))
    if controller.driving_function != DRIVING_FUNCTION:
        return  # an installed function that is not known here
    for name in PLANNER_PARAMETERS:
        if (name in parameters) == (name in controller.values):
            message = f"the planner's {name} is {'a parameter, too' if name in parameters else 'missing'}"
            remedy = "leave it out here" if name in parameters else f"add {name} to the problem's parameters, or here"
            yield Problem(f"simulator.controller.values.{name}", message, remedy)
    for name in (*parameters, *controller.values):
        if name not in PLANNER_PARAMETERS:
            field = "simulator.controller.values" if name in controller.values else "parameters"
            yield Problem(f"{field}.{name}", "the planner has no such parameter", nearest(name, PLANNER_PARAMETERS))


def task_problems(controller: AnyController, scenarios: Mapping[str, Any]) -> Iterator[Problem]:
    """Yields scenarios with a task but without a planner, and the planner's scenarios without a task."""
    planned = isinstance(controller, PlannerController)
    for name, data in scenarios.items():
        if planned != ("task" in data):
            message = "the planner drives scenarios with a task" if planned else "a task is for the planner alone"
            yield Problem(f"scenarios.{name}.task", message, "add it, or another controller" if planned else "leave it out")


def scenarios_problems(step: float, scenarios: Mapping[str, Any]) -> Iterator[Problem]:
    """Yields the faults of all scenarios. `step`: the simulator's (s)."""
    for name, data in scenarios.items():
        scenario = attempted(declared_scenario, data)
        yield from (replace(each, field=f"scenarios.{name}.{each.field}".rstrip(".")) for each in problems_of(scenario))
        if not isinstance(scenario, InvalidInputError):
            yield from scenario_problems(f"scenarios.{name}", scenario, step)


def files_named(scenarios: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yields the field of each file that a scenario names, and its path."""
    for name, data in scenarios.items():
        for key in ENDINGS:
            if isinstance(data.get(key), str):
                yield f"scenarios.{name}.{key}", data[key]


def declared_scenario(data: Mapping[str, Any]) -> Declared:
    """Returns a scenario's data as a model. Raises InvalidInputError with all faults."""
    if "task" in data:
        return validated(TaskScenario, dict(data))
    return validated(OpenScenario, dict(data)) if "openscenario" in data else validated(HighwayScenario, dict(data))


def scenario_problems(
    field: str, scenario: Declared, step: float, *, is_whole: bool = False, others: Collection[str] = ()
) -> Iterator[Problem]:
    """Yields the faults of a scenario.

    Args:
        field: The scenario's in the manifest.
        scenario: As it is declared, or with the entries of its files.
        step: The simulator's (s).
        is_whole: Its files have been read, so that every vehicle is known.
        others: Ids of vehicles of its route file.
    """
    yield from _files(field, scenario)
    duration, step = scenario.duration, scenario.step if isinstance(scenario, TaskScenario) else step
    yield from _steps(f"{field}.duration", duration, step)
    seen: set[str | None] = {"ego"}
    traffic: Sequence[TrafficEntry | TrafficVehicle] = scenario.traffic
    for index, entry in enumerate(traffic):
        if entry.id in seen:
            remedy = "give another id" if entry.id != "ego" else "give another id; ego is the controlled vehicle"
            yield Problem(f"{field}.traffic[{index}].id", f"the id {entry.id} is taken", remedy)
        seen |= {entry.id} - {None}
    if isinstance(scenario, TaskScenario):
        return
    yield from _behaviours(field, scenario.traffic)
    yield from _paths(field, scenario)
    is_whole = is_whole or (scenario.routes is None and isinstance(scenario, HighwayScenario))
    yield from actions_problems(field, scenario.traffic, is_whole=is_whole, others=others)
    yield from _times(field, scenario, step)


def _paths(field: str, scenario: Described) -> Iterator[Problem]:
    """Yields fields that contradict a path."""
    for index, entry in enumerate(scenario.traffic):
        if entry.path is None:
            continue
        place = f"{field}.traffic[{index}]"
        if entry.model != "constant":
            yield Problem(f"{place}.model", f"{entry.model} drives on lanes, and the vehicle on a path", "give model: constant")
        for key in {"lane", "edge", "offset", "route", "lane_change"} & entry.model_fields_set:
            yield Problem(f"{place}.{key}", "the vehicle moves along a path, on no lane", "leave it out, or leave `path` out")
        if all(point == entry.path[0] for point in entry.path):
            yield Problem(f"{place}.path", "all points of the path are one", "give two different points")


def _times(field: str, scenario: Described, step: float) -> Iterator[Problem]:
    """Yields the faults of `begin` and `warm_up`."""
    if scenario.begin and scenario.routes is None:
        message = "it is the time of a route file at which the run begins, but there are no `routes`"
        yield Problem(f"{field}.begin", message, "leave it out, or give `routes`")
    warm_up = scenario.warm_up
    if scenario.routes is not None and scenario.begin < warm_up:
        message = f"the warm-up of {warm_up:g} s begins before the route file's time 0"
        yield Problem(f"{field}.begin", message, f"give at least {warm_up:g}, or a shorter warm_up")
    yield from _steps(f"{field}.warm_up", warm_up, step)
    if warm_up and scenario.routes is None:
        message = "the vehicles of a route file drive in the warm-up, but there are no `routes`"
        yield Problem(f"{field}.warm_up", message, "leave it out, or give `routes`")


def _files(field: str, scenario: Declared) -> Iterator[Problem]:
    """Yields the faults of the paths that a scenario names."""
    for key, (endings, kind) in ENDINGS.items():
        path = getattr(scenario, key, None)
        if path is None:
            continue
        if not path.lower().endswith(endings):
            remedy = f"give the path of a {' or '.join(endings)} file of the bundle"
            yield Problem(f"{field}.{key}", f"{shown(path)} is {kind}", remedy)
        elif key == "network" and any(character in path for character in SPLITTING):
            message = f"{shown(path)} has a comma or a dollar sign, by which SUMO reads other files"
            yield Problem(f"{field}.network", message, "rename the file")


def _steps(field: str, duration: float | None, step: float) -> Iterator[Problem]:
    """Yields a duration that is not a multiple of the simulator's step; a step that is wrong itself is reported alone."""
    if duration and _is_multiple(step, TICK) and not _is_multiple(duration, step):
        message = f"{duration:g} s is not a multiple of the simulator's step of {step:g} s"
        yield Problem(field, message, f"give e.g. {max(1, round(duration / step)) * step:g}")


def _behaviours(field: str, behaviours: Sequence[TrafficBehaviour]) -> Iterator[Problem]:
    named: dict[str | None, str] = {}
    for index, behaviour in enumerate(behaviours):
        named.setdefault(behaviour.lane_change, f"traffic[{index}]")
        for key, value in behaviour.parameters.items():
            place = f"{field}.traffic[{index}].parameters.{key}"
            if key in ABOVE_ZERO and value <= 0.0:
                yield Problem(place, f"{value:g} is not above 0", "give a number above 0")
            if key == "minGap" and value < 0.0:
                yield Problem(place, f"{value:g} is below 0", "give 0 or more")
            if key not in TYPE_PARAMETERS:
                message = "SUMO's vehicle types have no such numeric attribute"
                yield Problem(place, message, nearest(key, sorted(TYPE_PARAMETERS)))
    if "SL2015" in named and "LC2013" in named:
        message = f"SUMO has one kind of lanes: {named['SL2015']} has SL2015 and {named['LC2013']} LC2013"
        yield Problem(f"{field}.{named['LC2013']}.lane_change", message, "give all vehicles one of them, or none")


def measures_problems(
    measures: Mapping[str, str], series: Mapping[str, str], failures: Sequence[str], *, has_planner: bool
) -> Iterator[Problem]:
    """Yields declared measures, series and failures that the simulator lacks or has in another unit."""
    known = FAILURES if not has_planner else tuple(Failure)
    yield from _known("measures", measures, CLOSED_LOOP_MEASURES if has_planner else MEASURES)
    yield from _known("series", series, {} if has_planner else SERIES)
    for index, name in enumerate(failures):
        if name not in known:
            yield Problem(f"failures[{index}]", f"the simulator reports no {shown(name)}", nearest(name, known))
    if failures and (missing := [name for name in known if name not in failures]):
        yield Problem("failures", f"the simulator also reports {', '.join(missing)}", "add them, or leave `failures` out")


def _known(section: str, declared: Mapping[str, str], catalogue: Mapping[str, str]) -> Iterator[Problem]:
    for name, unit in declared.items():
        if name not in catalogue:
            yield Problem(f"{section}.{name}", "the simulator does not report it", nearest(name, list(catalogue)))
        elif not units.same(unit, catalogue[name]):
            message = f"its unit is {catalogue[name]}, not {shown(unit)}"
            yield Problem(f"{section}.{name}", message, f"give {catalogue[name]}, and convert in the formulas of scores")


def _is_multiple(value: float, unit: float) -> bool:
    count = round(value / unit)
    return count >= 1 and abs(count * unit - value) <= 1e-9 * max(1.0, value)


def actions_problems(
    field: str, traffic: Sequence[TrafficEntry], *, is_whole: bool, others: Collection[str] = ()
) -> Iterator[Problem]:
    """Yields the faults of all actions.

    Args:
        field: The scenario's in the manifest.
        traffic: The vehicles with their actions.
        is_whole: Every vehicle is among `traffic` and `others`, so that unknown names are faults.
        others: Ids of vehicles of a route file.
    """
    named_here = (vehicle.id or f"vehicle{index}" for index, vehicle in enumerate(traffic))
    vehicles = [EGO, *named_here, *others] if is_whole else None
    ids: dict[str, str] = {}
    actions = [
        (f"{field}.traffic[{index}].actions[{number}]", vehicle, action)
        for index, vehicle in enumerate(traffic)
        for number, action in enumerate(vehicle.actions)
    ]
    for place, _, action in actions:
        if action.id is not None and action.id in ids:
            yield Problem(f"{place}.id", f"the id {action.id} is taken", "give each action another id")
        elif action.id is not None:
            ids[action.id] = place
    for place, vehicle, action in actions:
        given = [name for name in ("time", "gap", "s", "when") if getattr(action, name) is not None]
        if len(given) != 1:
            message = f"the action has {' and '.join(given) or 'nothing'} to begin at"
            yield Problem(place, message, "give exactly one of time, gap, s and when")
        yield from _action_problems(place, vehicle, action)
        siblings = [other.id for other in vehicle.actions if other.id is not None and other is not action]
        yield from _unknown(
            [(f"{place}.ends[{number}]", name) for number, name in enumerate(action.ends)],
            siblings,
            "other action of the vehicle",
        )
        named = [(f"{place}.{key}", getattr(action, key, None)) for key in ("like", "beside", "other")]
        for section in ("after", "when"):
            for number, condition in enumerate(getattr(action, section) or ()):
                inner = f"{place}.{section}[{number}]"
                yield from _condition_problems(inner, condition)
                named += [(f"{inner}.{key}", getattr(condition, key)) for key in ("vehicle", "to")]
                if is_whole:
                    parts = [(f"{inner}.{key}", getattr(condition, key)) for key in ("begun", "done")]
                    yield from _unknown(parts, list(ids), "action")
        if vehicles is not None:
            yield from _unknown(named, vehicles, "vehicle of `traffic`")


def _unknown(named: Sequence[tuple[str, str | None]], known: Sequence[str], noun: str) -> Iterator[Problem]:
    for field, name in named:
        if name is not None and name not in known:
            yield Problem(field, f"there is no {noun} {name}", nearest(name, known))


def _condition_problems(field: str, condition: Condition) -> Iterator[Problem]:
    given = [name for name in ("quantity", "begun", "done") if getattr(condition, name) is not None]
    limits = [name for name in ("above", "below") if getattr(condition, name) is not None]
    if len(given) != 1:
        message = f"the condition has {' and '.join(given) or 'nothing'} to wait for"
        yield Problem(field, message, "give exactly one of quantity, begun and done")
    elif len(limits) != (condition.quantity is not None):
        message = f"the condition has {' and '.join(limits) or 'no limit'}"
        yield Problem(field, message, "give above or below with a quantity, and none of them without")
    elif condition.to is not None and condition.quantity not in RELATIVE:
        yield Problem(f"{field}.to", f"{given[0]} is of one vehicle", "leave it out")
    elif condition.quantity == "distance" and (condition.s is None or condition.below is None):
        yield Problem(field, "a distance needs a place and a limit", "give `s` and `below`")
    elif condition.quantity != "distance" and (condition.s is not None or condition.d != 0.0):
        yield Problem(f"{field}.{'d' if condition.s is None else 's'}", f"{given[0]} is measured to no place", "leave it out")


def _action_problems(field: str, vehicle: TrafficEntry, action: Action) -> Iterator[Problem]:
    if isinstance(action, Brake):
        yield from _at_most_one(field, action, ("rate", "seconds", "metres"))
        if action.like is None and action.speed < 0.0:
            yield Problem(f"{field}.speed", f"{action.speed:g} m/s is below 0", "give 0 or more, or `like` a vehicle")
        if action.like is None and (action.continuous or action.factor != 1.0):
            key = "continuous" if action.continuous else "factor"
            yield Problem(f"{field}.{key}", "there is no vehicle to compare with", "add `like`, or leave it out")
        return
    if isinstance(action, Meet) and vehicle.path is None:
        yield Problem(field, "the vehicle has no path", "add `path`, or brake")
    if isinstance(action, CutIn | Drift) and vehicle.path is not None:
        yield Problem(field, "the vehicle moves along a path, on no lane", "give its way by the path")
    if isinstance(action, Drift):
        yield from _at_most_one(field, action, ("seconds", "lateral_acceleration"))
    if not isinstance(action, CutIn):
        return
    yield from _at_most_one(field, action, ("seconds", "metres", "lateral_speed"))
    if (action.lane is None) == (action.by is None):
        message = "the action has no lane to change to" if action.lane is None else "the action has lane and by"
        yield Problem(f"{field}.lane", message, "give exactly one of lane and by")
    if action.beside is not None and action.by is None:
        yield Problem(f"{field}.beside", "the lane is given by its index", "give `by` instead of `lane`")
    if vehicle.lane_change != "none":
        remedy = "leave out `lane_change`: SUMO's model would change back"
        yield Problem(field, f"the vehicle changes lanes by {vehicle.lane_change}", remedy)


def _at_most_one(field: str, action: Action, names: Sequence[str]) -> Iterator[Problem]:
    given = [name for name in names if getattr(action, name) is not None]
    if len(given) > 1:
        yield Problem(field, f"the action has {' and '.join(given)}", f"give one of {', '.join(names)}")

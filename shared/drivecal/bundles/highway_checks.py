"""Checks of a manifest's simulator `highway` beyond single fields."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from drivecal.bundles.highway import (
    AnyController,
    CutIn,
    Driver,
    FmuController,
    HighwayScenario,
    HighwaySimulator,
    ProcessController,
    Trigger,
)
from drivecal.bundles.highway_catalogue import COMMANDS, FAILURES, MEASURES, SERIES, SIGNALS, TYPE_PARAMETERS, Quantity
from drivecal.contracts.input_errors import nearest, validated
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem

TICK = 0.01
"""Step of the vehicle's dynamics (s), of which all other steps are multiples."""
NETWORKS = (".net.xml", ".xodr")
SPLITTING = ",$"
"""Characters of a path that SUMO takes for a list of files and for variables of the environment."""
ABOVE_ZERO = frozenset({"accel", "decel", "emergencyDecel", "apparentDecel", "tau", "stepping"})
"""Attributes of vehicle types that SUMO refuses at 0 and below."""


def simulator_problems(simulator: HighwaySimulator) -> Iterator[Problem]:
    """Yields the faults of the simulator section itself; files are checked with those of other kinds."""
    controller, step = simulator.controller, simulator.step
    period = step if controller.period is None else controller.period
    if not _is_multiple(step, TICK):
        yield Problem("simulator.step", f"{step:g} s is no multiple of {TICK:g} s", "give e.g. 0.1")
    elif not _is_multiple(period, TICK):
        yield Problem("simulator.controller.period", f"{period:g} s is no multiple of {TICK:g} s", "give e.g. 0.1")
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
                yield Problem(field, f"{shown(name)} is no signal", nearest(name, list(SIGNALS)))
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


def scenarios_problems(step: float, scenarios: Mapping[str, Any]) -> Iterator[Problem]:
    """Yields the faults of all scenarios. `step`: the simulator's (s)."""
    for name, data in scenarios.items():
        scenario = scenario_of(name, data)
        if isinstance(scenario, InvalidInputError):
            yield from scenario.problems
        else:
            yield from _scenario(f"scenarios.{name}", scenario, step)


def networks(scenarios: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yields the field of each scenario's network and the path that it names."""
    for name, data in scenarios.items():
        if isinstance(data.get("network"), str):
            yield f"scenarios.{name}.network", data["network"]


def scenario_of(name: str, data: Mapping[str, Any]) -> HighwayScenario | InvalidInputError:
    """Returns a scenario's data as a model, or all its faults, with the names of their fields in the manifest."""
    try:
        return validated(HighwayScenario, dict(data))
    except InvalidInputError as error:
        prefixed = (replace(problem, field=_joined(f"scenarios.{name}", problem.field)) for problem in error.problems)
        return InvalidInputError(*prefixed)


def _joined(prefix: str, field: str) -> str:
    return f"{prefix}.{field}" if field else prefix


def _scenario(field: str, scenario: HighwayScenario, step: float) -> Iterator[Problem]:
    if not scenario.network.endswith(NETWORKS):
        message = f"{shown(scenario.network)} is neither a SUMO network nor an OpenDRIVE file"
        yield Problem(f"{field}.network", message, f"give the path of a {' or '.join(NETWORKS)} file of the bundle")
    elif any(character in scenario.network for character in SPLITTING):
        message = f"{shown(scenario.network)} has a comma or a dollar sign, by which SUMO reads other files"
        yield Problem(f"{field}.network", message, "rename the file")
    if _is_multiple(step, TICK) and not _is_multiple(scenario.duration, step):
        message = f"{scenario.duration:g} s is no multiple of the simulator's step of {step:g} s"
        yield Problem(f"{field}.duration", message, f"give e.g. {max(1, round(scenario.duration / step)) * step:g}")
    seen = {"ego"}
    ids = [(f"traffic[{index}]", entry.id) for index, entry in enumerate(scenario.traffic)]
    ids += [(f"flows[{index}]", entry.id) for index, entry in enumerate(scenario.flows)]
    for entry, name in ids:
        if name is not None and name in seen:
            remedy = "give another id" if name != "ego" else "give another id; ego is the controlled vehicle"
            yield Problem(f"{field}.{entry}.id", f"the id {name} is taken", remedy)
        elif name is not None:
            seen.add(name)
    drivers: list[tuple[str, Driver]] = [(f"traffic[{index}]", entry) for index, entry in enumerate(scenario.traffic)]
    drivers += [(f"flows[{index}]", entry) for index, entry in enumerate(scenario.flows)]
    yield from _drivers(field, drivers)
    for index, vehicle in enumerate(scenario.traffic):
        for number, action in enumerate(vehicle.actions):
            place = f"{field}.traffic[{index}].actions[{number}]"
            yield from _trigger(place, action)
            if isinstance(action, CutIn) and vehicle.lane_change != "none":
                remedy = "leave out `lane_change`: SUMO's model would change back"
                yield Problem(place, f"the vehicle changes lanes by {vehicle.lane_change}", remedy)
    for index, flow in enumerate(scenario.flows):
        if flow.end is not None and flow.end <= flow.begin:
            yield Problem(f"{field}.flows[{index}].end", "the flow ends before it begins", f"give more than {flow.begin:g}")
        if flow.begin >= scenario.duration:
            message = f"the flow begins after the scenario's duration of {scenario.duration:g} s"
            yield Problem(f"{field}.flows[{index}].begin", message, f"give less than {scenario.duration:g}")
        if flow.speed is not None and flow.desired_speed is not None and flow.speed > flow.desired_speed:
            message = f"the vehicles would enter faster than their desired speed of {flow.desired_speed:g} m/s"
            yield Problem(f"{field}.flows[{index}].speed", message, f"give at most {flow.desired_speed:g}")


def _drivers(field: str, drivers: Sequence[tuple[str, Driver]]) -> Iterator[Problem]:
    for name, driver in drivers:
        for key, value in driver.parameters.items():
            if key in ABOVE_ZERO and value <= 0.0:
                yield Problem(f"{field}.{name}.parameters.{key}", f"{value:g} is not above 0", "give a number above 0")
            if key == "minGap" and value < 0.0:
                yield Problem(f"{field}.{name}.parameters.{key}", f"{value:g} is below 0", "give 0 or more")
            if key not in TYPE_PARAMETERS:
                message = "SUMO's vehicle types have no such numeric attribute"
                yield Problem(f"{field}.{name}.parameters.{key}", message, nearest(key, sorted(TYPE_PARAMETERS)))
    sublane = [name for name, driver in drivers if driver.lane_change == "SL2015"]
    others = [name for name, driver in drivers if driver.lane_change == "LC2013"]
    if sublane and others:
        message = f"SUMO has one kind of lanes: {sublane[0]} has SL2015 and {others[0]} LC2013"
        yield Problem(f"{field}.{others[0]}.lane_change", message, "give all vehicles one of them, or none")


def _trigger(field: str, trigger: Trigger) -> Iterator[Problem]:
    given = [name for name in ("time", "gap", "s") if getattr(trigger, name) is not None]
    if len(given) != 1:
        message = f"the action has {' and '.join(given) or 'nothing'} to begin at"
        yield Problem(field, message, "give exactly one of time, gap and s")


def measures_problems(measures: Mapping[str, str], series: Mapping[str, str], failures: Sequence[str]) -> Iterator[Problem]:
    """Yields declared measures, series and failures that the simulator lacks or has in another unit."""
    yield from _known("measures", measures, MEASURES)
    yield from _known("series", series, SERIES)
    for index, name in enumerate(failures):
        if name not in FAILURES:
            yield Problem(f"failures[{index}]", f"the simulator reports no {shown(name)}", nearest(name, FAILURES))
    if failures and (missing := [name for name in FAILURES if name not in failures]):
        yield Problem("failures", f"the simulator also reports {', '.join(missing)}", "add them, or leave `failures` out")


def _known(section: str, declared: Mapping[str, str], catalogue: Mapping[str, Quantity]) -> Iterator[Problem]:
    for name, unit in declared.items():
        if name not in catalogue:
            yield Problem(f"{section}.{name}", "the simulator does not report it", nearest(name, list(catalogue)))
        elif _plain(unit) != _plain(catalogue[name].unit):
            message = f"its unit is {catalogue[name].unit}, not {shown(unit)}"
            yield Problem(f"{section}.{name}", message, f"give {catalogue[name].unit}, and convert in the formulas of scores")


def _plain(unit: str) -> str:
    """Returns a unit in plain letters: m/s^2 is m/s²."""
    return unit.replace("²", "2").replace("³", "3").replace("^", "").replace("**", "").replace(" ", "")


def _is_multiple(value: float, unit: float) -> bool:
    count = round(value / unit)
    return count >= 1 and abs(count * unit - value) <= 1e-9 * max(1.0, value)

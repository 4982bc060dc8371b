"""Checks of a problem's section against what an FMU says of its variables: inputs without a value, constants, units of parameters.

The FMU's child imports this, at each start: it has no part in the models of manifests.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from difflib import get_close_matches
from typing import Any

from drivecal.bundles import units
from drivecal.bundles.fmus.description import INTEGERS, NUMBERS, FmuVariable, Variables
from drivecal.bundles.highway_catalogue import COMMANDS, SIGNALS
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import Problem

SETTABLE = frozenset({"input", "parameter"})
"""Causalities of variables that constants may give."""
COMPUTED = frozenset({"output", "calculatedParameter", "independent"})
"""Causalities of variables that the FMU gives."""
MOST_COMPARED = 1000
"""Names that are compared with a wrong one: an FMU may have a hundred thousand."""
ANY_NUMBER = "any number"  # in the place of a value: that of a parameter without a step
LARGEST_FLOAT32 = (2 - 2**-23) * 2.0**127


def section_problems(
    field: str, section: Mapping[str, Any], variables: Variables, parameters: Mapping[str, str]
) -> Iterator[Problem]:
    """Yields what does not fit between an FMU and the `section` of a controller.

    Args:
        field: The section's place in the manifest.
        section: Of a controller.
        variables: The FMU's.
        parameters: Units of the problem's parameters by name.
    """
    yield from _signals(field, section, variables)
    yield from _fixed(field, section, variables, parameters)
    yield from _inputs(field, section, variables, parameters)
    yield from unit_problems(variables, parameters)


def unit_problems(variables: Variables, parameters: Mapping[str, str]) -> Iterator[Problem]:
    """Yields the parameters whose unit is another one than their variables state. `parameters`: units by name."""
    for name, unit, variable in _parameters(variables, parameters):
        if unit.strip() not in units.WITHOUT and not any(units.same(spelling, unit) for spelling in variable.spellings):
            remedy = f"give the unit and the values in {shown(variable.unit)}, or convert in the FMU"
            yield Problem(f"parameters.{name}.unit", f"the FMU has {name} in {shown(variable.unit)}, not {shown(unit)}", remedy)


def reduction_of(measure: str) -> tuple[str, str]:
    """Returns reduction and output of a measure that the manifest's check accepts: `last` and `x` of `last(x)`."""
    reduction, _, output = measure.partition("(")
    return reduction, output.rpartition(")")[0].strip()


def output_problems(variables: Variables, used: Iterable[tuple[str, str, str, bool]]) -> Iterator[Problem]:
    """Yields variables that are used in another unit than they state.

    `used`: the field of each, its name, the unit, and whether this is the unit of its integral over time.
    """
    for field, name, unit, is_integral in used:
        suffix, whose = (".s", "the integral of ") if is_integral else ("", "")
        stated = [f"{spelling}{suffix}" for spelling in variables[name].spellings] if name in variables else []
        if stated and unit.strip() not in units.WITHOUT and not any(units.same(each, unit) for each in stated):
            message = f"{whose}the variable {name} is in {shown(stated[0])} by its FMU, not in {shown(unit)}"
            yield Problem(field, message, "give this unit, or convert in the FMU")


def value_problems(variables: Variables, values: Iterable[tuple[str, str, object]]) -> Iterator[Problem]:
    """Yields values that the FMU's variables do not take: integers of any other size would wrap, what is computed is not set.

    `values`: the field of each, the variable's name and the value.
    """
    for field, name, value in values:
        if name in variables and (wanted := wanted_by(variables[name], value)) is not None:
            what = "computed by the FMU" if variables[name].is_computed else f"of type {variables[name].kind}"
            yield Problem(field, f"{shown(value)} does not fit: {shown(name)} is {what}", wanted)


def unit_notes(variables: Variables, parameters: Mapping[str, str]) -> Iterator[str]:
    """Yields a note for each parameter without a unit that the FMU takes in one. `parameters`: units by name."""
    for name, unit, variable in _parameters(variables, parameters):
        if unit.strip() in units.WITHOUT and not any(units.same(spelling, "1") for spelling in variable.spellings):
            yield f"parameters.{name}: no unit is given; the FMU takes it in {shown(variable.unit)}"


def input_notes(field: str, section: Mapping[str, Any], variables: Variables) -> Iterator[str]:
    """Yields a note for each input that the `section` of a controller leaves out and that no manifest can give."""
    given = set(section["signals"].values())
    for variable in variables.values():
        if variable.causality == "input" and not variable.is_settable and variable.name not in given:
            kind = f"an array of {variable.kind}" if variable.is_array else f"of type {variable.kind}"
            yield f"{field}: nothing can give the FMU's input {shown(variable.name)}, {kind}; it stays as the FMU starts"


def unused_notes(field: str, used: Collection[str], variables: Variables) -> Iterator[str]:
    """Yields a note that counts the inputs, outputs and parameters of the FMU at `field` that are not `used`."""
    kinds = Counter(each.causality for each in variables.values() if each.name not in used)
    if counts := [f"{count:,} {kind}{'s' * (count > 1)}" for kind, count in kinds.items() if kind in SETTABLE | {"output"}]:
        yield f"{field}: the problem leaves out {', '.join(counts)} of the FMU; what is not set stays as the FMU starts"


def _parameters(variables: Variables, parameters: Mapping[str, str]) -> Iterator[tuple[str, str, FmuVariable]]:
    """Yields name, unit and variable of each parameter that an FMU has in a unit."""
    for variable in variables.values():
        if variable.name in parameters and variable.spellings:
            yield variable.name, parameters[variable.name], variable


def _signals(field: str, section: Mapping[str, Any], variables: Variables) -> Iterator[Problem]:
    """Yields the signals whose variables have the wrong direction or unit."""
    read = section["output"]
    for name, variable in section["signals"].items():
        if variable not in variables:
            continue  # named by the check of all names
        causality = variables[variable].causality
        if name in read and causality in SETTABLE:
            message = f"{shown(variable)} is an {causality} of the FMU, which computes no {name}"
            yield Problem(f"{field}.signals.{name}", message, "name an output of the FMU")
        elif name not in read and causality in COMPUTED:
            message = f"{shown(variable)} is an {causality} of the FMU, which takes no {name} there"
            yield Problem(f"{field}.signals.{name}", message, "name an input of the FMU")
        unit = (COMMANDS if name in read else SIGNALS).get(name, "1")
        yield from output_problems(variables, [(f"{field}.signals.{name}", variable, unit, False)])


def _fixed(field: str, section: Mapping[str, Any], variables: Variables, parameters: Mapping[str, str]) -> Iterator[Problem]:
    signals = {variable: name for name, variable in section["signals"].items()}
    for name, value in (section.get("constants") or {}).items():
        at = f"{field}.constants.{shown(name)}"
        if name not in variables:
            settable = [variable.name for variable in variables.values() if variable.causality in SETTABLE]
            similar = get_close_matches(name, settable[:MOST_COMPARED], 3) or sorted(settable)[:5]
            remedy = f"give inputs or parameters, e.g. {', '.join(map(shown, similar))}" if similar else "leave it out"
            yield Problem(at, f"the FMU has no variable {shown(name)}", remedy)
        elif name in signals or name in parameters:
            other = f"the signal {signals[name]}" if name in signals else "the parameter of this name"
            yield Problem(at, f"{other} gives it already", "leave one of them out")
        elif variables[name].causality not in SETTABLE:
            message = f"{shown(name)} is neither an input nor a parameter of the FMU, but {variables[name].causality}"
            yield Problem(at, message, "leave it out")
        else:
            yield from value_problems(variables, [(at, name, value)])


def wanted_by(variable: FmuVariable, value: object) -> str | None:
    """Returns what a variable takes instead of a value, None if it fits."""
    if not variable.is_settable:
        return "such variables cannot be set; let the FMU fix its value"
    if variable.kind == "String":
        return None if isinstance(value, str) else "give a text"
    if variable.kind == "Enumeration" and variable.items and isinstance(value, str):
        return None if value in variable.items else f"give {', '.join(map(shown, variable.items[:10]))}"
    if variable.kind == "Boolean":
        return None if not isinstance(value, str) and value in (0, 1) else "give true or false"
    if value == ANY_NUMBER:
        return None if variable.kind in NUMBERS else "add `integer: true`"
    if isinstance(value, (bool, str)) or not isinstance(value, (int, float)):
        return "give a number"
    if variable.kind == "Float32" and abs(value) > LARGEST_FLOAT32:
        return f"give a number from {-LARGEST_FLOAT32:g} to {LARGEST_FLOAT32:g}"
    if variable.kind in NUMBERS:
        return None
    least, most = INTEGERS.get(variable.kind, INTEGERS["Int64"])
    return None if value == int(value) and least <= value <= most else f"give a whole number from {least} to {most}"


def _inputs(field: str, section: Mapping[str, Any], variables: Variables, parameters: Mapping[str, str]) -> Iterator[Problem]:
    """Yields the inputs that nothing gives, though something could (else `input_notes`).

    A start value is no statement: it would hold for the whole run, unnoticed.
    """
    given = {*section["signals"].values(), *(section.get("constants") or {}), *parameters}
    for variable in variables.values():
        if variable.causality == "input" and variable.is_settable and variable.name not in given:
            start = "" if variable.start is None else f", which would stay at its start value {variable.start:g}"
            name = shown(variable.name)
            remedy = f"add `{name}: VALUE` to `constants`, or a signal to `signals`"
            yield Problem(f"{field}.constants", f"nothing gives the FMU's input {name}{start}", remedy)

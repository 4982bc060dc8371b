"""The search space of a campaign: the values that its parameters may take."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from typing import Any

from pydantic import TypeAdapter

from drivecal.bundles.shapes import Shapes, with_coefficients
from drivecal.contracts.specification import CampaignSpecification, Given, ParameterSpecification
from drivecal.domain.constraints import Constraint, Constraints
from drivecal.domain.errors import Diagnostics, InvalidInputError, Problem, attempted, problems_of
from drivecal.domain.parameters import Parameter, ParameterSet, ParameterSpace
from drivecal.domain.values import Setting, Value, billionths, decimal, text


@dataclass(frozen=True)
class Function:
    """The parameters of what is under test: of a driving function, or of the simulator of a bundle."""

    name: str
    """Name of the function or problem."""
    spaces: Mapping[str, tuple[Parameter, ...]]
    """Search spaces by name, each with all parameters in order, the default first."""
    limits: Mapping[str, tuple[float | None, float | None]]
    """Smallest and largest value that a user's own space may contain, by parameter; None means unlimited."""
    constraints: Mapping[str, Constraint]
    """Constraints by their text."""
    shapes: Shapes = field(default_factory=dict)
    """Curves and maps, whose coefficients are parameters."""


def search_parameters(parameters: str | Sequence[ParameterSpecification] | None, function: Function) -> tuple[Parameter, ...]:
    """The grid of each listed parameter, or of the function's own.

    Raises InvalidInputError for unknown spaces and names, empty grids, forbidden values."""
    if parameters is None:
        return next(iter(function.spaces.values()))
    if isinstance(parameters, str):
        if parameters not in function.spaces:
            remedy = f"one of {', '.join(function.spaces)}, or a list of parameters"
            raise InvalidInputError(Problem("parameters", f"{function.name} has no parameter space {parameters!r}", remedy))
        return function.spaces[parameters]
    diagnostics = Diagnostics()
    grids: list[Parameter] = []
    known = tuple(_default_space(function))
    singles = [
        (f"parameters[{index}]", listed.model_copy(update={"name": name}))
        for index, listed in enumerate(parameters)
        for name in (function.shapes[listed.name].names if listed.name in function.shapes else (listed.name,))
    ]
    for where, listed in singles:
        if listed.name not in known:
            diagnostics.add(f"{where}.name", f"{function.name} has no parameter {listed.name!r}", _remedy(known))
            continue
        if any(listed.name == other.name for other in grids):
            diagnostics.add(f"{where}.name", f"{listed.name} is listed twice", "list each parameter once")
            continue
        usual = _default_space(function)[listed.name]
        unsaid = {"unit": usual.unit} if listed.unit == "1" else {}
        parameter = attempted(Parameter.declared, **listed.model_dump() | unsaid)
        if isinstance(parameter, InvalidInputError):
            named = (replace(each, field=where + each.field.removeprefix(listed.name)) for each in parameter.problems)
            diagnostics.problems.extend(named)
            continue
        grids.append(parameter)
        if bool(parameter.choices) != bool(usual.choices) or not set(parameter.choices) <= set(usual.choices):
            diagnostics.add(f"{where}.choices", f"{function.name} takes {listed.name} {usual.extent}", "list such values")
        elif not parameter.choices:
            _within_limits(function, listed.name, parameter.lower, f"{where}.lower", diagnostics)
            _within_limits(function, listed.name, parameter.upper, f"{where}.upper", diagnostics)
    diagnostics.raise_if_any()
    return tuple(sorted(grids, key=lambda parameter: known.index(parameter.name)))


def _remedy(names: Sequence[str]) -> str:
    return f"one of {', '.join(names)}; if another problem is meant, name it in `problem`"


def _default_space(function: Function) -> dict[str, Parameter]:
    return {parameter.name: parameter for parameter in next(iter(function.spaces.values()))}


def covers(outer: Parameter, inner: Parameter) -> bool:
    """Returns whether all values of a parameter lie within the range or among the choices of another one."""
    if outer.choices or inner.choices:
        return bool(inner.choices) and set(inner.choices) <= set(outer.choices)
    return outer.lower <= inner.lower and inner.upper <= outer.upper


_SPACE = TypeAdapter(tuple[Parameter, ...])


def space_to_document(space: Sequence[Parameter]) -> Any:
    """JSON-ready and exact: bounds as decimal texts. Descriptions are left to the driving function."""
    return _SPACE.dump_python(tuple(space), mode="json", exclude={"__all__": {"description"}}, exclude_defaults=True)


def space_from_document(document: Sequence[Mapping[str, Any]]) -> tuple[Parameter, ...]:
    """The inverse of `space_to_document`."""
    return _SPACE.validate_python(document)


def fixed_to_document(fixed: Mapping[str, Value]) -> dict[str, str | dict[str, str]]:
    """JSON-ready and exact: numbers as decimal texts, choices as `{"choice": text}`."""
    return {name: {"choice": value} if isinstance(value, str) else text(value) for name, value in fixed.items()}


def fixed_from_document(document: Mapping[str, str | Mapping[str, str]]) -> dict[str, Value]:
    """The inverse of `fixed_to_document`."""
    return {name: Decimal(value) if isinstance(value, str) else value["choice"] for name, value in document.items()}


def search_space(specification: CampaignSpecification, function: Function, diagnostics: Diagnostics) -> ParameterSpace | None:
    """The space of a campaign with its fixed values; None if it is invalid, with its problems in `diagnostics`."""
    listed = diagnostics.attempt(lambda: search_parameters(specification.parameters, function))
    if listed is None:
        return None
    by_name = {parameter.name: parameter for parameter in listed}
    fixed: dict[str, Value] = {}
    defaults = _default_space(function)
    free = [each.name for each in listed if each.kind == "continuous" and defaults[each.name].kind == "grid"]
    if free:
        diagnostics.notes.append(f"{', '.join(free)}: searched without the problem's grid; give its `step` to keep it")
    names = tuple(defaults)
    settings = coefficients_in(None, specification.fixed, function.shapes, "fixed", diagnostics) or {}
    for name, given in settings.items():
        where = f"fixed.{name}"
        value = _value(given)
        if name not in names:
            diagnostics.add(where, f"{function.name} has no parameter {name!r}", _remedy(names))
        elif name in by_name:
            diagnostics.problems.extend(problems_of(attempted(by_name[name].index, value, where)))
        else:
            _check_free(function, defaults[name], value, where, diagnostics)
        fixed[name] = value
    missing = [name for name in names if name not in by_name and name not in fixed]
    if missing:
        single = len(missing) == 1
        needed = f"{function.name} needs {'a value' if single else 'values'} of {', '.join(missing)}"
        it = "it" if single else "them"
        diagnostics.add(f"fixed.{missing[0]}" if single else "fixed", needed, f"list {it} in `parameters` or in `fixed`")
    if by_name and set(by_name) <= set(fixed):
        diagnostics.add("fixed", "every parameter is held, so there is nothing to search", "leave at least one parameter free")
    if diagnostics.problems:
        return None
    return ParameterSpace(tuple(by_name.get(name, defaults[name]) for name in names), fixed)


def given_set(
    given: Mapping[str, Given] | None, constraints: Constraints | None, field: str, diagnostics: Diagnostics, shapes: Shapes
) -> ParameterSet | None:
    """A user's set on the grid that keeps the constraints; None if it is missing or invalid, with its problems in `diagnostics`. Curves
    and maps become the nearest ones of their coefficients in the space."""
    if given is None or constraints is None:
        return None
    space = constraints.space
    settings = coefficients_in(space, given, shapes, field, diagnostics)
    if settings is None:
        return None
    try:
        values = {name: _value(value) for name, value in settings.items()}
        owners = {each: name for name, shape in shapes.items() for each in shape.names}
        made = space.parameter_set(space.indices(values, field, owners).tolist())
        constraints.check(made, field)
    except InvalidInputError as error:
        diagnostics.problems.extend(error.problems)
        return None
    return made


def coefficients_in(
    space: ParameterSpace | None, given: Mapping[str, Given], shapes: Shapes, field: str, diagnostics: Diagnostics
) -> dict[str, Setting] | None:
    """Returns a set `with_coefficients` in the ranges of a space, if there is one; adds problems and notes."""
    ranges = {
        each.name: (float(each.lower), float(each.upper), float(each.upper - each.lower) / max(1, each.n_values - 1))
        for each in (() if space is None else space.parameters)
    }
    return diagnostics.attempt(lambda: with_coefficients(given, shapes, field, ranges, diagnostics.notes))


def free_values(given: Mapping[str, Given], function: Function, field: str, diagnostics: Diagnostics) -> dict[str, Value]:
    """Values between grid points, as of a single evaluation: exact decimals and texts by name, in the driving function's order."""
    defaults = _default_space(function)
    names = tuple(defaults)
    settings = coefficients_in(None, given, function.shapes, field, diagnostics)
    if settings is None:
        return {}
    for name in settings:
        if name not in names:
            diagnostics.add(f"{field}.{name}", f"{function.name} has no parameter {name!r}", _remedy(names))
    values: dict[str, Value] = {}
    for name in names:
        where = f"{field}.{name}"
        if name not in settings:
            diagnostics.add(where, "the value is missing", "give one value per parameter")
            continue
        values[name] = _value(settings[name])
        _check_free(function, defaults[name], values[name], where, diagnostics)
    return values


def notes_off_grid(values: Mapping[str, Value], function: Function) -> tuple[str, ...]:
    """Returns a note for each of `free_values` that no campaign on the driving function's own space asks for."""
    return tuple(
        f"{name}: {problem.message} ({problem.remedy}); it is simulated as given"
        for name, parameter in _default_space(function).items()
        for problem in problems_of(attempted(parameter.index, values[name], name))
    )


def _value(given: Setting) -> Value:
    return given if isinstance(given, str) else decimal(given)


def _check_free(function: Function, usual: Parameter, value: Value, field: str, diagnostics: Diagnostics) -> None:
    """Adds a problem if a value is not a choice or whole number of `usual`, or not an exact number within the function's limits."""
    if usual.choices or isinstance(value, str):
        diagnostics.attempt(lambda: usual.index(value, field))
        return
    try:
        billionths(value)
    except ValueError as error:
        diagnostics.add(field, str(error), "round it")
    if usual.kind == "integer" and value != value.to_integral_value():
        diagnostics.add(field, f"{value} is not a whole number", f"give e.g. {value.to_integral_value()}")
    _within_limits(function, usual.name, value, field, diagnostics)


def _within_limits(function: Function, name: str, value: Decimal, field: str, diagnostics: Diagnostics) -> None:
    smallest, largest = function.limits.get(name, (None, None))
    or_else = ", or push the problem with a wider range" if function.name in function.spaces else ""
    if smallest is not None and value < decimal(smallest):
        diagnostics.add(field, f"{value} is too small for {name}", f"give at least {text(decimal(smallest))}{or_else}")
    if largest is not None and value > decimal(largest):
        diagnostics.add(field, f"{value} is too large for {name}", f"give at most {text(decimal(largest))}{or_else}")

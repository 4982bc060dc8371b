"""The search space of a campaign: the values that its parameters may take."""

from collections.abc import Mapping, Sequence
from decimal import Decimal
from typing import Any, Protocol

from drivecal.campaigns.resolve.diagnostics import Diagnostics
from drivecal.contracts.specification import CampaignSpecification, ParameterSpecification
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.parameters import Parameter, ParameterSet, ParameterSpace, billionths, decimal, text


class Parameterised(Protocol):
    """A function under test, as far as its parameters go: a driving function, or the simulator of a bundle."""

    @property
    def name(self) -> str:
        """Its name."""

    @property
    def spaces(self) -> Mapping[str, tuple[Parameter, ...]]:
        """Search spaces by name, each with all parameters in order."""

    @property
    def limits(self) -> Mapping[str, tuple[float | None, float | None]]:
        """Smallest and largest value that a user's own space may contain, by parameter; None means unlimited."""


def search_parameters(
    parameters: str | Sequence[ParameterSpecification], function: Parameterised, field: str = "parameters"
) -> tuple[Parameter, ...]:
    """The grid of each listed parameter. Raises InvalidInputError for unknown spaces and names, empty grids, forbidden values."""
    if isinstance(parameters, str):
        if parameters not in function.spaces:
            remedy = f"one of {', '.join(function.spaces)}, or a list of parameters"
            raise InvalidInputError(Problem(field, f"{function.name} has no parameter space {parameters!r}", remedy))
        return function.spaces[parameters]
    diagnostics = Diagnostics()
    grids: list[Parameter] = []
    known = function_names(function)
    for index, listed in enumerate(parameters):
        where = f"{field}[{index}]"
        if listed.name not in known:
            diagnostics.add(f"{where}.name", f"{function.name} has no parameter {listed.name!r}", f"one of {', '.join(known)}")
            continue
        if any(listed.name == other.name for other in grids):
            diagnostics.add(f"{where}.name", f"{listed.name} is listed twice", "list each parameter once")
            continue
        try:
            parameter = Parameter.from_step(
                listed.name, decimal(listed.lower), decimal(listed.upper), decimal(listed.step), listed.unit
            )
        except InvalidInputError as error:
            for problem in error.problems:
                attribute = problem.field.removeprefix(f"{listed.name}.")
                diagnostics.add(f"{where}.{attribute}", problem.message, problem.remedy)
            continue
        _within_limits(function, listed.name, parameter.lower, f"{where}.lower", diagnostics)
        _within_limits(function, listed.name, parameter.upper, f"{where}.upper", diagnostics)
        grids.append(parameter)
    diagnostics.raise_if_any()
    return tuple(sorted(grids, key=lambda parameter: known.index(parameter.name)))


def function_names(function: Parameterised) -> tuple[str, ...]:
    """The names of all parameters of a driving function, in its order."""
    return tuple(parameter.name for parameter in next(iter(function.spaces.values())))


def space_to_document(space: Sequence[Parameter]) -> list[dict[str, Any]]:
    """JSON-ready and exact: bounds as decimal texts. Descriptions are left to the driving function."""
    return [
        {
            "name": parameter.name,
            "lower": text(parameter.lower),
            "upper": text(parameter.upper),
            "n_values": parameter.n_values,
            "unit": parameter.unit,
        }
        for parameter in space
    ]


def space_from_document(document: Sequence[Mapping[str, Any]]) -> tuple[Parameter, ...]:
    """The inverse of `space_to_document`."""
    return tuple(
        Parameter(entry["name"], Decimal(entry["lower"]), Decimal(entry["upper"]), entry["n_values"], entry["unit"])
        for entry in document
    )


def search_space(
    specification: CampaignSpecification, function: Parameterised, diagnostics: Diagnostics
) -> ParameterSpace | None:
    """The space of a campaign with its fixed values; None if it is invalid, with its problems in `diagnostics`."""
    try:
        listed = search_parameters(specification.parameters, function)
    except InvalidInputError as error:
        diagnostics.problems.extend(error.problems)
        return None
    by_name = {parameter.name: parameter for parameter in listed}
    fixed: dict[str, Decimal] = {}
    names = function_names(function)
    for name, given in specification.fixed.items():
        where = f"fixed.{name}"
        value = decimal(given)
        if name not in names:
            diagnostics.add(where, f"{function.name} has no parameter {name!r}", f"one of {', '.join(names)}")
        elif name in by_name:
            try:
                by_name[name].index(value, where)
            except InvalidInputError as error:
                diagnostics.problems.extend(error.problems)
        else:
            _exact(value, where, diagnostics)
            _within_limits(function, name, value, where, diagnostics)
        fixed[name] = value
    missing = [name for name in names if name not in by_name and name not in fixed]
    if missing:
        single = len(missing) == 1
        needed = f"{function.name} needs {'a value' if single else 'values'} of {', '.join(missing)}"
        it = "it" if single else "them"
        diagnostics.add(
            f"fixed.{missing[0]}" if single else "fixed", needed, f"list {it} in `parameters` or hold {it} in `fixed`"
        )
    if by_name and set(by_name) <= set(fixed):
        diagnostics.add("fixed", "every parameter is held, so there is nothing to search", "leave at least one parameter free")
    if diagnostics.problems:
        return None
    defaults = {parameter.name: parameter for parameter in next(iter(function.spaces.values()))}
    return ParameterSpace(tuple(by_name.get(name, defaults[name]) for name in names), fixed)


def given_set(
    given: Mapping[str, float] | None, space: ParameterSpace | None, field: str, diagnostics: Diagnostics
) -> ParameterSet | None:
    """A user's set on the grid; None if it is missing or invalid, with its problems in `diagnostics`."""
    if given is None or space is None:
        return None
    try:
        return space.parameter_set(space.indices({name: decimal(value) for name, value in given.items()}, field).tolist())
    except InvalidInputError as error:
        diagnostics.problems.extend(error.problems)
        return None


def free_values(given: Mapping[str, float], function: Parameterised, diagnostics: Diagnostics) -> dict[str, Decimal]:
    """Values between grid points for a single evaluation: exact decimals by name, in the driving function's order."""
    names = function_names(function)
    for name in given:
        if name not in names:
            diagnostics.add(f"parameters.{name}", f"{function.name} has no parameter {name!r}", f"one of {', '.join(names)}")
    values: dict[str, Decimal] = {}
    for name in names:
        where = f"parameters.{name}"
        if name not in given:
            diagnostics.add(where, "the value is missing", "give one value per parameter")
            continue
        values[name] = decimal(given[name])
        _exact(values[name], where, diagnostics)
        _within_limits(function, name, values[name], where, diagnostics)
    return values


def _exact(value: Decimal, field: str, diagnostics: Diagnostics) -> None:
    try:
        billionths(value)
    except ValueError as error:
        diagnostics.add(field, str(error), "round it")


def _within_limits(function: Parameterised, name: str, value: Decimal, field: str, diagnostics: Diagnostics) -> None:
    smallest, largest = function.limits.get(name, (None, None))
    if smallest is not None and value < decimal(smallest):
        diagnostics.add(field, f"{value} is too small for {name}", f"give at least {text(decimal(smallest))}")
    if largest is not None and value > decimal(largest):
        diagnostics.add(field, f"{value} is too large for {name}", f"give at most {text(decimal(largest))}")

"""Parameters of OpenSCENARIO files: declarations, constraints, `$name` and `${expression}` in attributes."""

import re
from collections.abc import Mapping

from drivecal.bundles.expressions import Formula, UndefinedError
from drivecal.bundles.traffic.elements import Element, finite
from drivecal.contracts.input_errors import nearest
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem

_NAME = re.compile(r"\$([A-Za-z_][A-Za-z0-9_.]*)")
_RULES = {
    "equalTo": lambda value, limit: value == limit,
    "notEqualTo": lambda value, limit: value != limit,
    "greaterThan": lambda value, limit: value > limit,
    "greaterOrEqual": lambda value, limit: value >= limit,
    "lessThan": lambda value, limit: value < limit,
    "lessOrEqual": lambda value, limit: value <= limit,
}


def substituted(element: Element, text: str) -> str:
    """Returns the text of an attribute with its parameters replaced. Raises InvalidInputError."""
    text = text.strip()
    if text.startswith("${") and text.endswith("}"):
        return _computed(element, text[2:-1])
    match = _NAME.fullmatch(text)
    if match is None:
        raise element.fault(f"{shown(text)} is not a parameter", "give $name or ${expression}")
    return _value(element, match[1])


def declare(owner: Element, given: Mapping[str, object]) -> None:
    """Takes the declarations inside of an element, with other values for some. Raises InvalidInputError with fields `parameters.name`."""
    section = owner.optional("ParameterDeclarations")
    declarations = section.every("ParameterDeclaration") if section is not None else []
    for declaration in declarations:
        name = declaration.text("name").removeprefix("$")
        owner.parameters[name] = _text(given[name]) if name in given else declaration.text("value")
    known = list(owner.parameters)
    for name in given:
        if name not in owner.parameters:
            raise InvalidInputError(Problem(f"parameters.{name}", "the file declares no such parameter", nearest(name, known)))
    for declaration in declarations:
        _check(declaration, declaration.text("name").removeprefix("$"), given)


def _check(declaration: Element, name: str, given: Mapping[str, object]) -> None:
    """Raises InvalidInputError if a value fulfils none of its groups of constraints."""
    groups = declaration.every("ConstraintGroup")
    value = _value(declaration, name)
    for group in groups:
        group.skip()
    if groups and not any(all(_holds(limit, value) for limit in group.every("ValueConstraint")) for group in groups):
        message = f"{shown(value)} breaks its constraints in the file"
        if name in given:
            raise InvalidInputError(Problem(f"parameters.{name}", message, f"see line {declaration.line}"))
        raise declaration.fault(message, "give another value in `parameters`")


def _holds(limit: Element, value: str) -> bool:
    rule, other = limit.word("rule", _RULES), limit.text("value")
    numbers = finite(value), finite(other)
    if None in numbers:
        return {"equalTo": value == other, "notEqualTo": value != other}.get(rule, False)
    return bool(_RULES[rule](*numbers))


def _computed(element: Element, expression: str) -> str:
    values: dict[str, float] = {}

    def named(match: re.Match[str]) -> str:
        name = f"p{len(values)}"
        number = finite(_value(element, match[1]))
        if number is None:
            raise element.fault(f"the parameter {shown(match[1])} is not a number", "give it a number")
        values[name] = number
        return name

    text = _NAME.sub(named, expression)
    try:
        return _text(Formula(text, values, "expression")(values))
    except InvalidInputError as error:
        problem = error.problems[0]
        raise element.fault(f"{shown('${' + expression + '}')}: {problem.message}", problem.remedy) from error
    except UndefinedError as error:
        raise element.fault(f"{shown('${' + expression + '}')} has no value: {error}", "give other parameters") from error


def _value(element: Element, name: str) -> str:
    """Returns the value of a parameter: of the innermost declaration around an element."""
    known: list[str] = []
    owner: Element | None = element
    while owner is not None:
        if name in owner.parameters:
            return owner.parameters[name]
        known += owner.parameters
        owner = owner.parent
    raise element.fault(f"there is no parameter {shown(name)}", nearest(name, known))


def _text(value: object) -> str:
    """Returns a value of a scenario as the file would write it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return str(int(value))
    return str(value)

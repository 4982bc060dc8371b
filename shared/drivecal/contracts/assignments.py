"""Reads and writes `NAME=VALUE`, as it stands on a command line and in a query."""

import math
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from drivecal.contracts.specification import Given
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem

Value = TypeVar("Value")


def value_text(value: Given, digits: int | None = 6) -> str:
    """Returns a number with `digits` significant digits, a list, or the text of a choice. None: as few digits as give the number again."""
    if isinstance(value, str | list):
        return str(value)
    return repr(float(value)).removesuffix(".0") if digits is None else f"{value:.{digits}g}"


def settings(parts: Iterable[str], field: str) -> dict[str, Given]:
    """Returns `P1=0.5`, `mode=eco`, `gain=[1, 2]` by name: numbers, lists, else text. Raises InvalidInputError as `assignments`."""
    return _named(parts, field, lambda given: _value(given, field))


def _value(given: str, field: str) -> Given | None:
    if not given.startswith("["):
        return given or None if (number := finite_number(given)) is None else number
    try:
        return TypeAdapter[Given](Given).validate_json(given)
    except ValidationError as error:
        raise InvalidInputError(Problem(field, f"{shown(given)} is no list of numbers", "write e.g. [1, 2.5]")) from error


def assignments(parts: Iterable[str], field: str) -> dict[str, float]:
    """Returns `P1=0.5`, `P2=3` as numbers by name. Raises InvalidInputError naming `field` and each faulty part."""
    return _named(parts, field, finite_number)


def _named(parts: Iterable[str], field: str, read: Callable[[str], Value | None]) -> dict[str, Value]:
    """Returns what `read` makes of each value, by name; None is a fault."""
    values: dict[str, Value] = {}
    problems: list[Problem] = []
    for part in parts:
        name, equals, given = (piece.strip() for piece in part.partition("="))
        if not equals or not name:
            problems.append(Problem(field, f"{shown(part)} is not an assignment", "write NAME=NUMBER"))
        elif (value := read(given)) is None:
            problems.append(Problem(f"{field} {name}", f"{shown(given)} is not a number", "give a finite number, e.g. 0.5"))
        elif name in values:
            problems.append(Problem(f"{field} {name}", "it is given twice", "give it once"))
        else:
            values[name] = value
    if problems:
        raise InvalidInputError(*problems)
    return values


def finite_number(given: Any) -> float | None:
    """Returns what is given as a finite number; None if it is none."""
    try:
        value = float(given)
    except (TypeError, ValueError):
        return None
    is_meant = "_" not in str(given) and not isinstance(given, bool)  # 1_5 is 15 in Python alone
    return value if math.isfinite(value) and is_meant else None

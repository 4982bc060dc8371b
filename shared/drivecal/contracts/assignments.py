"""Reads and writes `NAME=VALUE`, as it stands on a command line and in a query."""

import math
from collections.abc import Iterable

from pydantic import TypeAdapter, ValidationError

from drivecal.contracts.specification import Given
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem


def value_text(value: Given, digits: int | None = 6) -> str:
    """Returns a number with `digits` significant digits, a list, or the text of a choice. None: as few digits as give the number again."""
    if isinstance(value, str | list):
        return str(value)
    return repr(float(value)).removesuffix(".0") if digits is None else f"{value:.{digits}g}"


def settings(parts: Iterable[str], field: str) -> dict[str, Given]:
    """Returns `P1=0.5`, `mode=eco`, `gain=[1, 2]` by name: numbers, lists, else text. Raises InvalidInputError as `assignments`."""
    listed = list(parts)
    texts = {}
    for part in listed:
        name, _, given = (piece.strip() for piece in part.partition("="))
        if name and given and _number(given) is None:
            texts[part] = given
    numbers = assignments([f"{part.partition('=')[0]}=0" if part in texts else part for part in listed], field)
    return {**numbers, **{part.partition("=")[0].strip(): _listed(given, field) for part, given in texts.items()}}


def _listed(given: str, field: str) -> Given:
    if not given.startswith("["):
        return given
    try:
        return TypeAdapter[Given](Given).validate_json(given)
    except ValidationError as error:
        raise InvalidInputError(Problem(field, f"{shown(given)} is no list of numbers", "write e.g. [1, 2.5]")) from error


def assignments(parts: Iterable[str], field: str) -> dict[str, float]:
    """Returns `P1=0.5`, `P2=3` as numbers by name. Raises InvalidInputError naming `field` and each faulty part."""
    values: dict[str, float] = {}
    problems: list[Problem] = []
    for part in parts:
        name, equals, digits = (piece.strip() for piece in part.partition("="))
        value = _number(digits)
        if not equals or not name:
            problems.append(Problem(field, f"{shown(part)} is not an assignment", "write NAME=NUMBER"))
        elif value is None:
            problems.append(Problem(f"{field} {name}", f"{shown(digits)} is not a number", "give a finite number, e.g. 0.5"))
        elif name in values:
            problems.append(Problem(f"{field} {name}", "it is given twice", "give it once"))
        else:
            values[name] = value
    if problems:
        raise InvalidInputError(*problems)
    return values


def _number(digits: str) -> float | None:
    try:
        value = float(digits)
    except ValueError:
        return None
    return value if math.isfinite(value) else None

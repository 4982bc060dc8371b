"""Reads `NAME=NUMBER`, as it stands on a command line and in a query."""

import math
from collections.abc import Iterable

from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem


def assignments(parts: Iterable[str], field: str) -> dict[str, float]:
    """Returns `P1=0.5`, `P2=3` as numbers by name. Raises InvalidInputError naming `field` and each faulty part."""
    values: dict[str, float] = {}
    problems: list[Problem] = []
    for part in parts:
        name, equals, digits = (piece.strip() for piece in part.partition("="))
        value = _number(digits)
        if not equals or not name:
            problems.append(Problem(field, f"{shown(part)} is no assignment", "write NAME=NUMBER"))
        elif value is None:
            problems.append(Problem(f"{field} {name}", f"{shown(digits)} is no number", "give a finite number, e.g. 0.5"))
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

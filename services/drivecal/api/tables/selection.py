"""Conditions that select rows of tables: `where=COLUMN>=NUMBER` and the like. Pure."""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from drivecal.contracts.assignments import finite_number
from drivecal.contracts.tables import Column
from drivecal.domain.errors import InvalidInputError, Problem

Row = Mapping[str, Any]
_CONDITION = re.compile(r"(?P<column>.+?)(?P<sign>>=|<=|=)(?P<value>.*)", re.DOTALL)
_REMEDY = "write COLUMN=VALUE, COLUMN>=NUMBER or COLUMN<=NUMBER"
_TRUTH = {"true": True, "false": False}

Keeps = Callable[[Row], bool]


def selection(conditions: Sequence[str], columns: Sequence[Column]) -> Keeps:
    """Returns whether a row is wanted: several values of a column are alternatives, everything else has to hold.

    A row without a value is not wanted. Raises InvalidInputError with every faulty condition.
    """
    known = {column.name: column for column in columns}
    problems: list[Problem] = []
    values: dict[str, set[object]] = {}
    ranges: list[tuple[str, str, float]] = []
    for place, condition in enumerate(conditions):
        try:
            name, sign, value = _read(condition, known)
        except ValueError as error:
            problems.append(Problem(f"where[{place}]", *error.args))
            continue
        if sign == "=":
            values.setdefault(name, set()).add(value)
        else:
            ranges.append((name, sign, value))  # type: ignore[arg-type]  # a number, as `_read` has seen to
    if problems:
        raise InvalidInputError(*problems)

    def keeps(row: Row) -> bool:
        return all(row.get(name) in wanted for name, wanted in values.items()) and all(
            (value := row.get(name)) is not None and (value >= bound if sign == ">=" else value <= bound)
            for name, sign, bound in ranges
        )

    return keeps


def _read(condition: str, known: Mapping[str, Column]) -> tuple[str, str, object]:
    """Returns column, sign and value. Raises ValueError with message and remedy."""
    parts = _CONDITION.fullmatch(condition)
    if parts is None:
        raise ValueError(f"{condition[:100]!r} is not a condition", _REMEDY)
    name, sign, text = (parts[part].strip() for part in ("column", "sign", "value"))
    column = known.get(name)
    if column is None or column.kind == "numbers":
        columns = ", ".join(other.name for other in known.values() if other.kind != "numbers")
        raise ValueError(f"there is no column {name[:100]!r} to select by", f"one of {columns}")
    if column.kind == "text":
        if sign != "=":
            raise ValueError(f"{name} holds words", f"write {name}=WORD")
        return name, sign, text
    if column.kind == "truth":
        if sign != "=" or text not in _TRUTH:
            raise ValueError(f"{name} is true or false", f"write {name}=true or {name}=false")
        return name, sign, _TRUTH[text]
    if (amount := finite_number(text)) is None:
        raise ValueError(f"{text[:100]!r} is not a number", f"write {name}{sign}NUMBER")
    return name, sign, amount

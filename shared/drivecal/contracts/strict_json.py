"""Reads JSON that comes from outside: RFC 8259 to the letter, without the surprises of Python's reader.

Python's own reader accepts NaN and Infinity, turns 1e999 into infinity, keeps the last of two equal keys, passes half surrogates
on (which no database stores) and fails with a RecursionError on deep nesting. Here each of these is an InvalidInputError.
"""

from __future__ import annotations

import json
import math
from typing import NoReturn

from drivecal.domain.errors import InvalidInputError, Problem

DEEPEST = 32
"""Nesting beyond this is refused; the deepest document that drivecal understands needs six levels."""


def loads(content: bytes) -> object:
    """The document in `content`. Raises InvalidInputError that says where and what is wrong."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InvalidInputError(
            Problem("", f"byte {error.start} is no valid UTF-8", "send the document as UTF-8 text")
        ) from error
    if not text.strip():
        raise InvalidInputError(Problem("", "the document is empty", "send a JSON object, e.g. {}"))
    try:
        document = json.loads(
            text, object_pairs_hook=_object, parse_constant=_no_constant, parse_float=_finite, parse_int=_integer
        )
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise InvalidInputError(Problem("", f"no valid JSON: {error.msg} at {where}", "correct the document there")) from error
    except RecursionError as error:
        raise _too_deep() from error
    check_plain(document)
    return document


def check_plain(document: object) -> None:
    """Raises InvalidInputError where plain data is nested too deeply or holds text that is no Unicode text."""
    waiting: list[tuple[object, int]] = [(document, 1)]
    while waiting:
        value, depth = waiting.pop()
        if isinstance(value, str):
            _check_text(value)
        elif isinstance(value, (dict, list)):
            if depth > DEEPEST:
                raise _too_deep()
            children = [*value.keys(), *value.values()] if isinstance(value, dict) else value
            waiting.extend((child, depth + 1) for child in children)


def _check_text(value: str) -> None:
    try:
        value.encode()
    except UnicodeEncodeError as error:
        raise InvalidInputError(
            Problem("", f"{value!a} holds half of a surrogate pair", "send whole Unicode characters")
        ) from error


def _object(pairs: list[tuple[str, object]]) -> dict[str, object]:
    document = dict(pairs)
    if len(document) != len(pairs):
        seen: set[str] = set()
        for key, _ in pairs:
            if key in seen:
                raise InvalidInputError(Problem(shown(key), "the key is there twice", "give each key once"))
            seen.add(key)
    return document


def _no_constant(name: str) -> NoReturn:
    raise InvalidInputError(Problem("", f"{name} is no JSON number", "give a finite number, or null"))


def _finite(digits: str) -> float:
    value = float(digits)
    if not math.isfinite(value):
        raise InvalidInputError(Problem("", f"{shown(digits)} is too large for a number", "give a smaller number"))
    return value


def _integer(digits: str) -> int:
    if len(digits) > 100:
        raise InvalidInputError(Problem("", f"an integer of {len(digits)} digits is too large", "give a smaller number"))
    return int(digits)


def shown(value: object, longest: int = 60) -> str:
    """A value as an error message quotes it: JSON-like, ASCII where it must be, never longer than `longest` characters."""
    if isinstance(value, str):
        text = (value if value.isprintable() else ascii(value)[1:-1]) or "''"
    elif value is None or isinstance(value, (bool, int, float)):
        text = {True: "true", False: "false", None: "null"}[value] if value is None or isinstance(value, bool) else str(value)
    else:
        text = "an object" if isinstance(value, dict) else "a list" if isinstance(value, list) else ascii(value)
    return text if len(text) <= longest else text[: longest - 1] + "…"


def _too_deep() -> InvalidInputError:
    return InvalidInputError(Problem("", f"the document is nested deeper than {DEEPEST} levels", "send a flatter one"))

"""Reads JSON that comes from outside: RFC 8259 to the letter, without the surprises of Python's reader.

Python's own reader accepts NaN and Infinity, turns 1e999 into infinity, keeps the last of two equal keys, passes half surrogates
on (which no database stores) and fails with a RecursionError on deep nesting. Here each of these is an InvalidInputError.

Texts of users may hold neither C1 control characters, separators of lines nor marks of direction, which steer a terminal or reverse what
is read. Names show something.
"""

import json
import math
import unicodedata
from collections import Counter
from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import AfterValidator, Field, StringConstraints

from drivecal.domain.errors import InvalidInputError, Problem

DEEPEST = 32
"""Nesting beyond this is refused; the deepest document that drivecal understands needs six levels."""
MOST_VALUES = 100_000
"""Values of a document: eight thousand start sets have fewer. Counted before parsing, which takes fifty times the text's memory."""
MOST_KEYS = 2_000
"""Fields of an object; the largest valid object has a thousand."""
_HARMLESS = {int, bool, type(None)}
_TOO_DEEP = Problem("", f"the document is nested deeper than {DEEPEST} levels", "send a flatter one")


def loads(content: bytes) -> object:
    """Returns the document in `content`. Raises InvalidInputError."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InvalidInputError(Problem("", f"byte {error.start} is not valid UTF-8", "send it as UTF-8 text")) from error
    values = sum(content.count(sign) for sign in (b",", b"[", b"{"))
    if values > MOST_VALUES:
        raise InvalidInputError(Problem("", f"the document has some {values:,} values", f"send at most {MOST_VALUES:,}"))
    if not text.strip():
        raise InvalidInputError(Problem("", "the document is empty", "send a JSON object, e.g. {}"))
    try:
        document = json.loads(text, object_pairs_hook=unique_keys, parse_int=_integer)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise InvalidInputError(Problem("", f"no valid JSON: {error.msg} at {where}", "correct the document there")) from error
    except RecursionError as error:
        raise InvalidInputError(_TOO_DEEP) from error
    check_plain(document)
    return document


def check_plain(document: object) -> None:
    """Raises InvalidInputError naming the field if plain data is nested too deeply, or has an object with too many entries, a number that
    is not finite, or text that is not Unicode."""
    waiting: list[tuple[object, tuple[str | int, ...]]] = [(document, ())]
    while waiting:
        value, path = waiting.pop()
        if isinstance(value, str):
            _check_text(value, path)
        elif isinstance(value, float) and not math.isfinite(value):
            message = "NaN is not a JSON number" if math.isnan(value) else "the number is not finite, or too large"
            raise InvalidInputError(Problem(field_name(path), message, "give a finite number, or null"))
        elif isinstance(value, (dict, list)):
            if len(path) >= DEEPEST:
                raise InvalidInputError(_TOO_DEEP)
            if isinstance(value, dict):
                if len(value) > MOST_KEYS:
                    message = f"the object has {len(value):,} entries"
                    raise InvalidInputError(Problem(field_name(path), message, f"give at most {MOST_KEYS:,}"))
                for key in value:
                    _check_text(key, path)
            children = value.items() if isinstance(value, dict) else enumerate(value)
            waiting.extend((child, (*path, key)) for key, child in children if type(child) not in _HARMLESS)


def field_name(path: Sequence[int | str]) -> str:
    """Returns a path as `optimizer.population` or `parameters[0].lower`."""
    name = ""
    for part in path:
        name += f"[{part}]" if isinstance(part, int) else f".{shown(part)}" if name else shown(part)
    return name


def _check_text(value: str, path: Sequence[int | str]) -> None:
    try:
        value.encode()
    except UnicodeEncodeError as error:
        message = f"{value!a} holds half of a surrogate pair"
        raise InvalidInputError(Problem(field_name(path), message, "send whole Unicode characters")) from error


def unique_keys(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Returns an object of JSON. Raises InvalidInputError for a second equal key."""
    document = dict(pairs)
    if len(document) != len(pairs):
        [(key, _)] = Counter(key for key, _ in pairs).most_common(1)
        raise InvalidInputError(Problem(shown(key), "the key appears twice", "give each key once"))
    return document


def _integer(digits: str) -> float:
    """Converts integers that no field can hold to infinity, so that their field can be named."""
    return int(digits) if len(digits) <= 100 else math.inf


def shown(value: object, longest: int = 60) -> str:
    """Returns a value for an error message: JSON-like, ASCII if not printable, at most `longest` characters."""
    if isinstance(value, str):
        text = (value if value.isprintable() else ascii(value)[1:-1]) or "''"
    elif value is None or isinstance(value, (bool, int, float)):
        text = {True: "true", False: "false", None: "null"}[value] if value is None or isinstance(value, bool) else str(value)
    else:
        text = "an object" if isinstance(value, dict) else "a list" if isinstance(value, list) else ascii(value)
    return text if len(text) <= longest else text[: longest - 1] + "…"


def _visible(text: str) -> str:
    if all(unicodedata.category(character) in _UNSEEN or character in _BLANK for character in text):
        raise ValueError(f"{shown(text)} shows nothing; give at least one letter, digit or sign")
    return text


_UNSEEN = {"Cc", "Cf", "Zs", "Zl", "Zp", "Mn", "Me"}
_BLANK = "\u115f\u1160\u2800\u3164\uffa0"
"""Letters and a sign that are drawn as nothing."""
_STEERING = r"\x7f-\x9f\u2028-\u202e\u2066-\u2069"
ONE_LINE = rf"^[^\x00-\x1f{_STEERING}]+$"
Name = Annotated[str, StringConstraints(min_length=1, max_length=200, pattern=ONE_LINE), AfterValidator(_visible)]
Source = Annotated[str, StringConstraints(min_length=1, max_length=200, strip_whitespace=True, pattern=ONE_LINE)]
"""Name of a vehicle, test bench or tool."""
Choice = Annotated[str, StringConstraints(min_length=1, max_length=64, pattern=ONE_LINE), AfterValidator(_visible)]
"""Text that names a choice."""
Tag = Annotated[
    str, StringConstraints(min_length=1, max_length=40, pattern=rf"^[^\x00-\x20{_STEERING},]+$"), AfterValidator(_visible)
]
"""A word without spaces and commas."""
Identifier = Annotated[str, StringConstraints(min_length=1, max_length=64, pattern=r"^[A-Za-z][A-Za-z0-9_.-]*$")]
ProblemName = Annotated[str, StringConstraints(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
"""Name of a problem, or digest of a bundle."""
UNIQUE: dict[str, Any] = {"uniqueItems": True}
"""Says in a JSON schema that no item comes twice. Checked elsewhere."""
Number = Annotated[float, Field(ge=-1e6, le=1e6)]

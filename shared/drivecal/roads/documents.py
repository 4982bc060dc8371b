"""XML of strangers, read element by element: no document types, no entities, bounded sizes, and a line number for every fault.

Notes on a file are equal ones in one line, with the places that they are about, and no more than are read.
"""

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from xml.parsers import expat

from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem

ROUNDED = 1e-6
"""Metres beyond an end that are no more than rounding."""
MOST_NOTES = 50
"""Notes on a file; the last line says how many more there are."""
MOST_PLACES = 5
"""Places that a note names."""


class JoinedNotes:
    """Notes by text, in the order of the first of each."""

    def __init__(self) -> None:
        self._places: dict[str, dict[str, None]] = {}

    def add(self, place: str, text: str) -> None:
        """Adds a note on a place, e.g. `road 7, lane -1`. The same note on the same place counts once."""
        self._places.setdefault(text, {})[place] = None

    def texts(self) -> list[str]:
        """Returns a line for each text: the first places and how many more, and the text."""
        return [f"{joined(list(places))}: {text}" for text, places in self._places.items()]


def joined(places: Sequence[str]) -> str:
    """Returns the first places, and how many more there are."""
    more = f" and {len(places) - MOST_PLACES} more" if len(places) > MOST_PLACES else ""
    return "; ".join(places[:MOST_PLACES]) + more


def cut(notes: Iterable[str], most: int = MOST_NOTES) -> tuple[str, ...]:
    """Returns the first notes, and a last note with the number of the others."""
    lines = tuple(notes)
    return lines if len(lines) <= most else (*lines[:most], f"and {len(lines) - most} more notes")


LARGEST = 64 << 20
"""Bytes of a file."""
MOST_ELEMENTS = 2_000_000
DEEPEST = 32
LONGEST_VALUE = 4_000_000
"""Characters of an attribute: a lane of some hundred thousand points."""

_INTEGER = re.compile(r"[+-]?[0-9]{1,9}")


class Attributes:
    """The attributes of an element and its line: reads numbers, names and words, and refuses others."""

    __slots__ = ("element", "file", "line", "values")

    def __init__(self, file: str, element: str, values: Mapping[str, str], line: int) -> None:
        self.file, self.element, self.values, self.line = file, element, values, line

    def fault(self, message: str, remedy: str) -> InvalidInputError:
        """Returns the refusal of the element."""
        name = self.values.get("id")
        element = f"<{self.element} id={shown(name, 60)}>" if name is not None else f"<{self.element}>"
        return InvalidInputError(Problem(self.file, f"line {self.line}, {element}: {message}", remedy))

    def text(self, key: str, default: str | None = None) -> str:
        """Returns an attribute. Raises InvalidInputError if it is missing and has no default."""
        value = self.values.get(key, default)
        if value is None:
            raise self.fault(f"the attribute {key} is missing", "write the file again with the program that made it")
        return value

    def number(self, key: str, lower: float, upper: float, default: float | None = None) -> float:
        """Returns a finite number between two bounds. Raises InvalidInputError."""
        text = self.text(key, None if default is None else repr(default))
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if -ROUNDED <= value < lower == 0.0:  # exporters compute places
            return 0.0
        if not lower <= value <= upper or "_" in text:
            message = f"{key} is {shown(text, 40)}, which is not a number between {lower:g} and {upper:g}"
            raise self.fault(message, "correct the number")
        return value

    def integer(self, key: str, lower: int, upper: int) -> int:
        """Returns a whole number between two bounds, written without a point. Raises InvalidInputError."""
        text = self.text(key)
        if not _INTEGER.fullmatch(text) or not lower <= int(text) <= upper:
            message = f"{key} is {shown(text, 40)}, which is not a whole number from {lower} to {upper}"
            raise self.fault(message, "correct the number")
        return int(text)

    def truth(self, key: str) -> bool:
        """Returns a truth value as SUMO reads it; a missing attribute is false."""
        return self.values.get(key, "0").lower() in {"1", "true", "yes", "on", "x", "t"}


def read_elements(
    content: bytes, name: str, root: str, start: Callable[[Attributes], None], end: Callable[[str], None]
) -> None:
    """Calls `start` with each element of a file, and `end` with its tag when it closes.

    `name`: the file's name in messages; `root`: the tag that the document must begin with. Raises InvalidInputError, also whatever
    `start` and `end` raise.
    """
    _check_size(content, name, root)
    parser = expat.ParserCreate()
    depth = elements = 0

    def started(tag: str, values: dict[str, str]) -> None:
        nonlocal depth, elements
        attributes = Attributes(name, tag, values, parser.CurrentLineNumber)
        depth, elements = depth + 1, elements + 1
        if depth == 1 and tag != root:
            raise attributes.fault(f"the document is not a <{root}>", _REMEDIES.get(root, "give another file"))
        if depth > DEEPEST or elements > MOST_ELEMENTS:
            limit = f"nested deeper than {DEEPEST} levels" if depth > DEEPEST else f"of more than {MOST_ELEMENTS:,} elements"
            raise attributes.fault(f"the document is {limit}", "cut the part out that is driven")
        if any(len(value) > LONGEST_VALUE for value in values.values()):
            raise attributes.fault(f"an attribute has more than {LONGEST_VALUE:,} characters", "split the element")
        start(attributes)

    def ended(tag: str) -> None:
        nonlocal depth
        depth -= 1
        end(tag)

    def refused(*_: object) -> None:
        message = f"line {parser.CurrentLineNumber}: the file declares a document type, which may hold entities"
        raise InvalidInputError(Problem(name, message, "remove <!DOCTYPE ...>"))

    parser.StartElementHandler, parser.EndElementHandler = started, ended
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refused
    try:
        parser.Parse(content, True)  # expat's own signature
    except expat.ExpatError as error:
        message = f"line {error.lineno}: no well-formed XML: {expat.ErrorString(error.code)}"
        is_late = expat.ErrorString(error.code) == expat.errors.XML_ERROR_MISPLACED_XML_PI
        remedy = (
            "move <?xml ...?> to the beginning" if is_late else "save it in the encoding that it declares, or make it again"
        )
        raise InvalidInputError(Problem(name, message, remedy)) from error
    except (LookupError, ValueError) as error:
        if elements:  # a fault of the caller: the encoding is known before the first element
            raise
        raise InvalidInputError(Problem(name, "the file's encoding cannot be read", "save it as UTF-8")) from error


_REMEDIES = {
    "net": "give a SUMO network (.net.xml), or an OpenDRIVE file (.xodr)",
    "OpenDRIVE": "give an OpenDRIVE file (.xodr)",
    "OpenSCENARIO": "give an OpenSCENARIO file of version 1.x (.xosc)",
    "routes": "give a SUMO route file (.rou.xml)",
}


def _check_size(content: bytes, name: str, root: str) -> None:
    if content[:2] == b"\x1f\x8b":
        raise InvalidInputError(Problem(name, "the file is compressed", "unpack it: gunzip"))
    if len(content) > LARGEST:
        message = f"the file has {len(content) >> 20} MB, more than {LARGEST >> 20}"
        raise InvalidInputError(Problem(name, message, "cut the part out that is driven"))
    if not content.strip():
        raise InvalidInputError(Problem(name, "the file is empty", _REMEDIES.get(root, "give another file")))

"""The common content of calibration files: scalar characteristics, and the origin of their values."""

import math
from collections.abc import Collection
from dataclasses import dataclass, field

from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem

LARGEST_FILE = 256 << 20
MOST_CHARACTERISTICS = 1_000_000
UNITLESS = frozenset({"", "-", "1"})
"""Units of numbers without a unit; drivecal's is `1`, that of calibration files `-`."""


@dataclass(frozen=True, slots=True)
class Characteristic:
    """A scalar value of a control unit. What a file does not say is None or empty.

    `value`: a number, or the text of a choice, in physical units. `lower`, `upper`, `step`: limits and resolution. `choices`: texts of an
    enumeration, with their numbers in `codes`. `line` is its line in the file. `fault`: the reason why it cannot become a parameter; the
    other characteristics of its file can.
    """

    name: str
    value: float | str | None = None
    unit: str = "1"
    description: str = ""
    lower: float | None = None
    upper: float | None = None
    step: float | None = None
    integer: bool = False
    choices: tuple[str, ...] = ()
    codes: tuple[float, ...] = ()
    line: int = 0
    fault: Problem | None = None


@dataclass(frozen=True, slots=True)
class Quality:
    """Quality data of a chosen set, in the terms of CDF's history.

    `state`: maturity, e.g. `calibrated`; `date`: ISO 8601; `figures`: known numbers of the set, by name, e.g. `score S1`.
    """

    state: str
    date: str
    project: str
    work_product: str
    test_object: str
    campaign: str
    data: str = ""
    """Digest of the problem's files."""
    figures: tuple[tuple[str, str], ...] = ()


@dataclass(slots=True)
class Content:
    """Content of a file. `skipped`: names of characteristics that are not scalars."""

    characteristics: list[Characteristic] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)

    def add(self, file: str, characteristic: Characteristic, known: Collection[str]) -> None:
        """Adds a characteristic. Raises InvalidInputError if its name is `known`, or if there are too many."""
        if characteristic.name in known:
            raise refused(
                file,
                characteristic.line,
                f"{shown(characteristic.name)} appears twice",
                "keep one of the two, or export each MODULE alone",
            )
        if len(self.characteristics) >= MOST_CHARACTERISTICS:
            raise refused(
                file, characteristic.line, f"there are more than {MOST_CHARACTERISTICS:,} characteristics", "split it"
            )
        self.characteristics.append(characteristic)


def unit_of(text: str) -> str:
    """Returns drivecal's unit for that of a file."""
    return "1" if text.strip() in UNITLESS else text.strip()


def decoded(content: bytes, file: str) -> str:
    """Returns the text of a file: UTF-8, UTF-16 with a byte order mark, or else Windows-1252, which older tools write."""
    if len(content) > LARGEST_FILE:
        raise InvalidInputError(Problem(file, f"it has more than {LARGEST_FILE >> 20} MB", "give a smaller file"))
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        try:
            return content.decode("utf-16")
        except UnicodeDecodeError as error:
            raise InvalidInputError(Problem(file, f"byte {error.start} is not valid UTF-16", "save it as UTF-8")) from error
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")


def refused(file: str, line: int, message: str, remedy: str) -> InvalidInputError:
    """Returns the error of a file's line."""
    return InvalidInputError(problem_of(file, line, message, remedy))


def problem_of(file: str, line: int, message: str, remedy: str) -> Problem:
    """Returns the fault of a file's line."""
    return Problem(f"{shown(file, 200)}, line {line}" if line else shown(file, 200), message, remedy)


def number_or_fault(text: str, line: int, file: str) -> tuple[float, None] | tuple[float, Problem]:
    """Returns the number of a text, with a fault of its characteristic alone if it is not finite. Raises InvalidInputError naming file and
    line if it is no number."""
    try:
        value = float(text)
    except ValueError:
        raise refused(file, line, f"{shown(text)} is not a number", "give a finite number, with a point") from None
    if math.isfinite(value):
        return value, None
    return 0.0, problem_of(file, line, f"{shown(text)} is not finite", "correct the value, or leave it out by --match")


def on_one_line(text: str) -> str:
    """Returns a text without line breaks, control characters and double quotes, which strings of calibration files cannot hold safely."""
    plain = " ".join(text.split()).replace('"', "'")
    return "".join(character for character in plain if character.isprintable())

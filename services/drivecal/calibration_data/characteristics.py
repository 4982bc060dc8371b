"""The common content of calibration files: characteristics, and the origin of their values."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from drivecal.bundles import units
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem

LARGEST_FILE = 256 << 20
MOST_CHARACTERISTICS = 1_000_000
INDEX = "INDEX"  # kind of the axes of arrays, whose points are 0, 1, ...
Places = tuple[tuple[int, int], ...]
"""Begin and end of each number in the text of a DCM, or the bytes of a CDFX."""


@dataclass(frozen=True, slots=True)
class Axis:
    """An axis of a curve, map or array. `kind`: STD_AXIS, COM_AXIS, RES_AXIS, FIX_AXIS or INDEX. `points` are empty while no file says
    them. `shared`: name of the axis that stands in the file by itself. `lower`, `upper`: limits of the points."""

    kind: str
    points: tuple[float, ...] = ()
    unit: str = "1"
    shared: str = ""
    lower: float | None = None
    upper: float | None = None
    places: Places = ()


def index(size: int, kind: str = INDEX) -> Axis:
    """Returns an axis whose points are the numbers of the values."""
    return Axis(kind, tuple(map(float, range(size))))


def extents(sizes: Sequence[int]) -> list[int]:
    """Returns the sizes of an array. Sizes of 1 are left out, as in some files."""
    return [size for size in sizes if size != 1] or [*sizes[:1]]


@dataclass(frozen=True, slots=True)
class Characteristic:
    """A value, curve, map, array or axis of a control unit. What a file does not say is None or empty.

    `value`: a number, or the text of a choice, in physical units. `lower`, `upper`, `step`: limits and resolution. `choices`: texts of an
    enumeration, with their numbers in `codes`. `line` is its line in the file. `fault`: the reason why it cannot become a parameter; the
    other characteristics of its file can. `note`: a doubt. `kind`: VALUE, CURVE, MAP, VAL_BLK or COM_AXIS, the points of
    a shared axis. All but VALUE have `axes`, and `values` in the place of `value`: along the first axis first.
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
    note: str = ""
    kind: str = "VALUE"
    axes: tuple[Axis, ...] = ()
    values: tuple[float, ...] = ()
    places: Places = ()

    @property
    def rows(self) -> list[tuple[float, ...]]:
        """The values of a map or table, a row along the first axis for each point of the second one; of a curve one row."""
        width = len(self.values) // len(self.axes[1].points) if len(self.axes) > 1 else len(self.values)
        return [self.values[begin : begin + width] for begin in range(0, len(self.values), width or 1)]

    @property
    def given(self) -> Any:
        """The value as a problem has it: of a curve a list, of a map a list for each point of x. None without one for each
        of its points."""
        if not self.axes or not self.values or math.prod(len(axis.points) for axis in self.axes) != len(self.values):
            return self.value
        return list(self.values) if len(self.axes) == 1 else [list(column) for column in zip(*self.rows, strict=True)]


def other_units(held: Characteristic, wanted: Characteristic) -> Iterator[str]:
    """Yields each unit of values or axes that a file `held` and that is none of the problem's."""
    axes = zip("xy", held.axes, wanted.axes, strict=False)
    pairs = [("it", held.unit, wanted.unit), *((f"its axis {letter}", one.unit, other.unit) for letter, one, other in axes)]
    yield from (f"{what} in {unit}, and the problem in {own}" for what, unit, own in pairs if not units.agree(unit, own))


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
    """Content of a file. `skipped`: names of characteristics that cannot become parameters; `fixed`: those with values that no calibration
    changes, of whatever file they are."""

    characteristics: list[Characteristic] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    fixed: set[str] = field(default_factory=set)
    names: set[str] = field(default_factory=set)

    def add(self, file: str, name: str, given: Characteristic | None) -> None:
        """Adds a characteristic; None is skipped. Raises InvalidInputError if there is one of its name, or if there are too many."""
        if given is None:
            self.skipped.append(name)
            return
        if name in self.names:
            raise refused(file, given.line, f"{shown(name)} appears twice", "keep one of the two, or export each MODULE alone")
        if len(self.characteristics) >= MOST_CHARACTERISTICS:
            raise refused(file, given.line, f"there are more than {MOST_CHARACTERISTICS:,} characteristics", "split it")
        self.characteristics.append(given)
        self.names.add(name)


def unit_of(text: str) -> str:
    """Returns drivecal's unit for that of a file: `1` for `-`."""
    return "1" if text.strip() in units.WITHOUT else text.strip()


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
        value = float(text.replace("_", "?"))  # 1_0 is no number of a file
    except ValueError:
        raise refused(file, line, f"{shown(text)} is not a number", "give a finite number, with a point") from None
    if math.isfinite(value):
        return value, None
    return 0.0, problem_of(file, line, f"{shown(text)} is not finite", "correct the value, or leave it out by --match")


def on_one_line(text: str) -> str:
    """Returns a text without line breaks, control characters and double quotes, which strings of calibration files cannot hold safely."""
    plain = " ".join(text.split()).replace('"', "'")
    return "".join(character for character in plain if character.isprintable())


def quoted(text: str) -> str:
    """Returns a value that is a text as DCM has it, in double quotes, with its own ones doubled."""
    return '"' + text.replace('"', '""') + '"'

"""Parts of a page: what a report, a review sheet and the command line show of a campaign's results. `report.html` and
`cli.views.output` draw them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from markupsafe import Markup

from drivecal.domain.scales import objective_text


class Emphasized(str):
    """The text of a table's cell that stands out."""

    __slots__ = ()


class Number(str):
    """A number that is written already."""

    __slots__ = ()


@dataclass(frozen=True, slots=True)
class Paragraph:
    """A paragraph; `kind`: `key` for a result, `warn` for a warning, `light` for a light of trust."""

    text: str
    kind: Literal["", "key", "warn", "sub", "light"] = ""


@dataclass(frozen=True, slots=True)
class Heading:
    """The heading of a part of a section."""

    text: str


@dataclass(frozen=True, slots=True)
class Bullets:
    """A list of sentences."""

    items: Sequence[str]


@dataclass(frozen=True, slots=True)
class FileLinks:
    """Links to files of the page's folder."""

    names: Sequence[str]


@dataclass(frozen=True, slots=True)
class CommandLines:
    """Commands to type, a line each."""

    text: str


@dataclass(frozen=True, slots=True)
class Table:
    """A table. Columns of numbers are right-aligned; None is a dash. `command` prints its numbers again; review sheets show it. `wrap`
    breaks long texts into lines; `wrap_header` breaks titles too that are longer than the values."""

    header: Sequence[str]
    rows: Sequence[Sequence[object]]
    caption: str = ""
    command: str = ""
    wrap: bool = False
    wrap_header: bool = False
    kind: Literal["", "sign"] = ""
    """`sign`: room for signatures."""


@dataclass(frozen=True, slots=True)
class Figure:
    """A drawing with its caption and links to its files."""

    svg: Markup
    caption: str
    files: Sequence[str] = ()


Block = Paragraph | Heading | Bullets | FileLinks | CommandLines | Table | Figure


def fixed(value: float | None, digits: int, separator: Literal["", ","] = "") -> Number | None:
    """Returns a number with a fixed number of decimals and the `separator` of thousands; None for an unknown value."""
    return None if value is None else Number(f"{value:{separator}.{digits}f}")


def amount(value: float | None) -> Number | None:
    """Returns a number with six digits; None for an unknown one."""
    return None if value is None else Number(f"{value:.6g}")


def objective_number(value: float | None) -> Number | None:
    """Returns an objective as `objective_text` writes it; None for an unknown one."""
    return None if value is None else Number(objective_text(value))


def percent(share: float | None, digits: int = 2) -> Number | None:
    """Returns a share in percent; None for an unknown share."""
    return None if share is None else Number(f"{share:.{digits}%}")


def bound(upper_95: float | None) -> Number | str | None:
    """Returns a 95 % bound of a share in percent; `no bound` for 100 %, which excludes nothing, and None for an unknown one."""
    return "no bound" if upper_95 is not None and upper_95 >= 1.0 else percent(upper_95)


def totals(items: Iterable[object], *names: str) -> tuple[int, ...]:
    """Returns the sum of each of the named fields over all items."""
    listed = list(items)
    return tuple(sum(getattr(item, name) for item in listed) for name in names)


def counted(number: int, what: str) -> str:
    """Returns a number with a noun: `1 set`, `2 sets`."""
    return f"{number:,} {what}{'' if number == 1 else 's'}"


LONGEST_MESSAGE = 160


def shortened(words: str | None) -> str | None:
    """Returns the end of a message, where simulators say what is wrong."""
    return words if words is None or len(words) <= LONGEST_MESSAGE else f"...{words[3 - LONGEST_MESSAGE :]}"

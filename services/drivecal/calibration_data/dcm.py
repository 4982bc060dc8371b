"""DCM 2.0 (KONSERVIERUNG_FORMAT), the text format of INCA, CANape and MATLAB.

Its keywords are German. FESTWERT is a value, FESTWERTEBLOCK an array, KENNLINIE a curve, KENNFELD a map, STUETZSTELLENVERTEILUNG an axis
that several share (GRUPPEN...); FEST... stands before curves with a fixed axis. LANGNAME is the description, EINHEIT_W the unit, WERT the
values, ST/X and ST/Y points of the axes, TEXT a value that is a text.
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

from drivecal.calibration_data.characteristics import (
    Axis,
    Characteristic,
    Content,
    Places,
    Quality,
    decoded,
    extents,
    index,
    number_or_fault,
    on_one_line,
    problem_of,
    quoted,
    refused,
    unit_of,
)
from drivecal.contracts.strict_json import shown

FORMAT = "KONSERVIERUNG_FORMAT"
_COMMENTS = ("*", "!", ".")
_LISTS = frozenset({"FUNKTIONEN", "VARIANTENKODIERUNG", "TEXTSTRING"})
_LINES = frozenset({"MODULKOPF", "FKT"})
"""Keywords of lines without END: some tools write functions without a list around them."""
_KINDS = {
    "FESTWERT": ("VALUE", "", 0),
    "FESTWERTEBLOCK": ("VAL_BLK", "", 1),
    "KENNLINIE": ("CURVE", "STD_AXIS", 1),
    "FESTKENNLINIE": ("CURVE", "FIX_AXIS", 1),
    "GRUPPENKENNLINIE": ("CURVE", "COM_AXIS", 1),
    "KENNFELD": ("MAP", "STD_AXIS", 2),
    "FESTKENNFELD": ("MAP", "FIX_AXIS", 2),
    "GRUPPENKENNFELD": ("MAP", "COM_AXIS", 2),
    "STUETZSTELLENVERTEILUNG": ("COM_AXIS", "", 1),
}
"""Kind, kind of the axes, and their least number."""
_STRINGS = frozenset({"LANGNAME", "EINHEIT_X", "EINHEIT_Y", "EINHEIT_W", "TEXT"})
_UNUSED = frozenset({"FUNKTION", "DISPLAYNAME"})
_LINE = re.compile(r"([^\r\n]*)(?:\r\n|\r|\n|\Z)")  # other separators of Unicode may stand in a description
_WORD = re.compile(r"\S+")
_SHARED = re.compile(r"\*\s*SST([XY])\s+(\S+)")
"""Name of the axis of a curve, in a comment."""
_STRING = re.compile(r'"(.*)"\s*')  # some tools do not escape the quotes inside
_QUOTE = re.compile(r'\\"|""')


_Line = tuple[int, str, int]
"""Number, text without blanks around it, and where it begins."""


def write(characteristics: Sequence[Characteristic], quality: Quality | None = None) -> bytes:
    """Returns a file. Numbers keep all their digits; equal content gives equal bytes."""
    lines = ['* encoding="UTF-8"']
    if quality is not None:
        lines += [f"* {name}: {on_one_line(text)}" for name, text in _header(quality)]
    lines += [f"{FORMAT} 2.0", ""]
    for characteristic in characteristics:
        lines += _block(characteristic)
    return ("\r\n".join(lines) + "\r\n").encode()


def _header(quality: Quality) -> Iterator[tuple[str, str]]:
    yield from (("state", quality.state), ("date", quality.date), ("problem", quality.project))
    yield from (("campaign", f"{quality.work_product} ({quality.campaign})"), ("test object", quality.test_object))
    if quality.data:
        yield "data", quality.data
    yield from quality.figures


def _block(given: Characteristic) -> Iterator[str]:
    sizes = [str(len(axis.points)) for axis in given.axes]
    yield " ".join([_keyword(given), given.name, (" @ " if given.kind == "VAL_BLK" else " ").join(sizes)]).rstrip()
    if given.description:
        yield f'   LANGNAME "{on_one_line(given.description)}"'
    axes = dict(zip("XY", given.axes if given.kind in {"CURVE", "MAP"} else (), strict=False))
    for letter, unit in [*((letter, axis.unit) for letter, axis in axes.items()), ("W", given.unit)]:
        yield f'   EINHEIT_{"X" if given.kind == "COM_AXIS" else letter} "{"-" if unit == "1" else on_one_line(unit)}"'
    yield from (f"*SST{letter} {axis.shared}" for letter, axis in axes.items() if axis.shared)
    if "X" in axes:
        yield f"   ST/X {_numbers(axes['X'].points)}"
    for number, row in enumerate(given.rows if given.axes else ()):
        if "Y" in axes:
            yield f"   ST/Y {axes['Y'].points[number]!r}"
        yield f"   {'ST/X' if given.kind == 'COM_AXIS' else 'WERT'} {_numbers(row)}"
    if isinstance(given.value, str):
        yield f"   TEXT {quoted(given.value)}"
    elif given.value is not None:
        yield f"   WERT {given.value!r}"
    yield "END"
    yield ""


def _keyword(given: Characteristic) -> str:
    kinds = {axis.kind for axis in given.axes} if given.kind in {"CURVE", "MAP"} else {""}
    chosen = "COM_AXIS" if kinds & {"COM_AXIS", "RES_AXIS"} else "STD_AXIS" if "STD_AXIS" in kinds else kinds.pop()
    return next(keyword for keyword, pair in _KINDS.items() if pair[:2] == (given.kind, chosen))


def _numbers(values: Sequence[float]) -> str:
    return " ".join(map(repr, values))


def read(content: bytes, file: str) -> Content:
    """Returns the parameters of a file. Raises InvalidInputError with the line of the first fault."""
    return read_text(decoded(content, file), file)


def read_text(text: str, file: str) -> Content:
    """Returns the parameters of a file's text. Their places are those in the text."""
    lines = _lines(text)
    number, head, _ = next((line for line in lines if not line[1].startswith(_COMMENTS)), (1, "", 0))
    if not re.fullmatch(rf"{FORMAT}\s+2\.\d+", head):
        raise refused(file, number, f"{FORMAT} 2.0 is missing", "give a DCM file of version 2")
    result = Content()
    for number, line, _ in lines:
        keyword, _, rest = line.partition(" ")
        name, *sizes = rest.replace("@", " ").split() or [""]
        if keyword in _KINDS:
            if not name:
                raise refused(file, number, f"a {keyword} has no name", "give it one")
            result.add(file, name, _read_block(lines, keyword, name, sizes, number, file))
        elif keyword in _LISTS:
            list(_inside(lines, f"this {keyword}", number, file))
            result.skipped += [name] if keyword == "TEXTSTRING" else []
        elif keyword not in _LINES and not line.startswith(_COMMENTS):
            raise refused(file, number, f"{shown(keyword)} is not a keyword of DCM 2.0", "correct the line")
    return result


def _lines(text: str) -> Iterator[_Line]:
    """Yields the lines with content; of comments those alone that name the axes of a curve."""
    for number, match in enumerate(_LINE.finditer(text), 1):
        line = match[1].strip().replace("\t", " ")
        if line and (not line.startswith(_COMMENTS) or _SHARED.fullmatch(line)):
            yield number, line, match.start() + len(match[1]) - len(match[1].lstrip())


def _inside(lines: Iterator[_Line], block: str, begin: int, file: str) -> Iterator[_Line]:
    """Yields the lines of a block until its END. Raises InvalidInputError if the file ends or another block begins before."""
    for line in lines:
        key = line[1].partition(" ")[0]
        if key == "END":
            return
        if key in _KINDS or key in _LISTS:
            break
        yield line
    raise refused(file, begin, f"{block} has no END", "close it by END before the next keyword")


def _read_block(
    lines: Iterator[_Line], keyword: str, name: str, sizes: Sequence[str], begin: int, file: str
) -> Characteristic | None:
    """Returns a parameter, None if it has several variants of its value, or values of another sort."""
    kind, axis_kind, n_axes = _KINDS[keyword]
    numbers: dict[str, list[tuple[float, tuple[int, int]]]] = {"WERT": [], "ST/X": [], "ST/Y": []}
    texts: dict[str, str] = {}
    text_places: Places = ()
    fault, is_other = None, False
    for number, line, start in _inside(lines, shown(name), begin, file):
        key, _, rest = line.partition(" ")
        has_value = bool(numbers["WERT"]) or "TEXT" in texts
        if shared := _SHARED.fullmatch(line):
            texts[shared[1]] = shared[2]
        elif key in numbers:
            for match in _WORD.finditer(line, len(key)):
                value, of_value = number_or_fault(match[0], number, file)
                numbers[key].append((value, (start + match.start(), start + match.end())))
                fault = fault or of_value
        elif key in _STRINGS:
            texts[key] = _string(rest.strip(), number, file)
            text_places = ((start + len(line) - len(rest.lstrip()), start + len(line)),) if key == "TEXT" else text_places
        else:
            is_other = is_other or key not in _UNUSED
        if kind == "VALUE" and (len(numbers["WERT"]) > 1 or (has_value and key in {"WERT", "TEXT"})):
            raise refused(file, number, f"{shown(name)} has a second value", "keep one of the two")
    if is_other or (kind != "VALUE" and "TEXT" in texts):
        return None
    held = numbers["ST/X" if kind == "COM_AXIS" else "WERT"]
    counts = [int(size) for size in sizes[: max(n_axes, kind == "VAL_BLK" and 2)] if size.isdecimal() and len(size) < 10]
    counts = extents(counts) if kind == "VAL_BLK" else counts
    axes: list[Axis] = []
    for letter, count in zip("XY", counts, strict=False):
        points, places = zip(*numbers[f"ST/{letter}"], strict=True) if axis_kind and numbers[f"ST/{letter}"] else ((), ())
        own = Axis(axis_kind, points, unit_of(texts.get(f"EINHEIT_{letter}", "")), texts.get(letter, ""), places=places)
        axes.append(own if axis_kind else index(min(count, len(held))))
    missing = any(
        len(axis.points) != count and (axis.points or not axis.shared) for axis, count in zip(axes, counts, strict=True)
    )
    if missing or len(counts) < n_axes or (n_axes and len(held) != math.prod(counts)):
        message = f"{shown(name)} does not have as many values and points as it says"
        fault = fault or problem_of(file, begin, message, "correct the file, or leave it out by --match")
    unit = unit_of(texts.get("EINHEIT_X" if kind == "COM_AXIS" else "EINHEIT_W", ""))
    values, places = tuple(value for value, _ in held), tuple(place for _, place in held) or text_places
    read = Characteristic(name, None, unit, texts.get("LANGNAME", ""), line=begin, fault=fault, kind=kind, places=places)
    if n_axes:
        return replace(read, axes=tuple(axes), values=values)
    return replace(read, value=texts.get("TEXT", values[0] if values else None))


def _string(text: str, line: int, file: str) -> str:
    match = _STRING.fullmatch(text)
    if match is None:
        raise refused(file, line, f"{shown(text)} is not a string", "put it into double quotes")
    return _QUOTE.sub('"', match[1])

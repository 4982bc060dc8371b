"""DCM 2.0 (KONSERVIERUNG_FORMAT), the text format of INCA, CANape and MATLAB: scalar parameters (`FESTWERT`).

Its keywords are German: LANGNAME is the description, EINHEIT_W the unit, WERT the value, TEXT a value that is a text.
"""

import re
from collections.abc import Iterator, Sequence

from drivecal.calibration_data.characteristics import (
    Characteristic,
    Content,
    Quality,
    decoded,
    number_or_fault,
    on_one_line,
    refused,
    unit_of,
)
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import Problem

FORMAT = "KONSERVIERUNG_FORMAT"
_COMMENTS = ("*", "!", ".")
_LISTS = frozenset({"FUNKTIONEN", "VARIANTENKODIERUNG"})
_LINES = frozenset({"MODULKOPF", "FKT"})
"""Keywords of lines without END: some tools write functions without a list around them."""
_OTHER_KINDS = frozenset(
    {
        "FESTWERTEBLOCK",
        "KENNLINIE",
        "FESTKENNLINIE",
        "GRUPPENKENNLINIE",
        "KENNFELD",
        "FESTKENNFELD",
        "GRUPPENKENNFELD",
        "STUETZSTELLENVERTEILUNG",
        "TEXTSTRING",
    }
)
_UNUSED = frozenset({"FUNKTION", "DISPLAYNAME", "EINHEIT_X", "EINHEIT_Y"})
_LINE_END = re.compile(r"\r\n|\r|\n")  # other separators of Unicode may stand in a description
_STRING = re.compile(r'"(.*)"\s*')  # some tools do not escape the quotes inside
_QUOTE = re.compile(r'\\"|""')


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
    yield "state", quality.state
    yield "date", quality.date
    yield "problem", quality.project
    yield "campaign", f"{quality.work_product} ({quality.campaign})"
    yield "test object", quality.test_object
    if quality.data:
        yield "data", quality.data
    yield from quality.figures


def _block(characteristic: Characteristic) -> Iterator[str]:
    yield f"FESTWERT {characteristic.name}"
    if characteristic.description:
        yield f'   LANGNAME "{on_one_line(characteristic.description)}"'
    unit = on_one_line(characteristic.unit)
    yield f'   EINHEIT_W "{"-" if unit == "1" else unit}"'
    if isinstance(characteristic.value, str):
        yield f'   TEXT "{on_one_line(characteristic.value)}"'
    elif characteristic.value is not None:
        yield f"   WERT {characteristic.value!r}"
    yield "END"
    yield ""


def read(content: bytes, file: str) -> Content:
    """Returns the parameters of a file. Raises InvalidInputError with the line of the first fault."""
    lines = _lines(decoded(content, file))
    number, head = next(lines, (1, ""))
    if not re.fullmatch(rf"{FORMAT}\s+2\.\d+", head):
        raise refused(file, number, f"{FORMAT} 2.0 is missing", "give a DCM file of version 2")
    result = Content()
    names: set[str] = set()
    for number, line in lines:
        keyword, _, rest = line.partition(" ")
        name = rest.split()[0] if rest.split() else ""
        if keyword == "FESTWERT":
            if not name:
                raise refused(file, number, "a FESTWERT has no name", "give it one")
            characteristic = _scalar(lines, name, number, file)
            if characteristic is None:
                result.skipped.append(name)
            else:
                result.add(file, characteristic, names)
            names.add(name)
        elif keyword in _OTHER_KINDS or keyword in _LISTS:
            _skip(lines, keyword, number, file)
            if keyword in _OTHER_KINDS:
                result.skipped.append(name)
        elif keyword not in _LINES:
            raise refused(file, number, f"{shown(keyword)} is not a keyword of DCM 2.0", "correct the line")
    return result


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Yields the lines with content, stripped, with their numbers."""
    for number, line in enumerate(_LINE_END.split(text), 1):
        stripped = line.strip().replace("\t", " ")
        if stripped and not stripped.startswith(_COMMENTS):
            yield number, stripped


def _skip(lines: Iterator[tuple[int, str]], keyword: str, begin: int, file: str) -> None:
    if not any(line == "END" for _, line in lines):
        raise refused(file, begin, f"this {keyword} has no END", "complete the file")


def _scalar(lines: Iterator[tuple[int, str]], name: str, begin: int, file: str) -> Characteristic | None:
    """Returns a parameter, None if it has several variants of its value."""
    value: float | str | None = None
    fault: Problem | None = None
    unit, description, has_variants = "1", "", False
    for number, line in lines:
        keyword, _, rest = line.partition(" ")
        rest = rest.strip()
        if keyword == "END":
            return None if has_variants else Characteristic(name, value, unit, description, line=begin, fault=fault)
        if keyword in {"WERT", "TEXT"} and value is not None:
            raise refused(file, number, f"{shown(name)} has a second value", "keep one of the two")
        if keyword == "WERT":
            value, fault = number_or_fault(rest, number, file)
        elif keyword == "VAR":
            has_variants = True
        elif keyword == "TEXT":
            value = _string(rest, number, file)
        elif keyword == "LANGNAME":
            description = _string(rest, number, file)
        elif keyword == "EINHEIT_W":
            unit = unit_of(_string(rest, number, file))
        elif keyword not in _UNUSED:
            raise refused(
                file, number, f"{shown(keyword)} is not a keyword of a FESTWERT", "correct the line, or close the block by END"
            )
    raise refused(file, begin, f"{shown(name)} has no END", "complete the file")


def _string(text: str, line: int, file: str) -> str:
    match = _STRING.fullmatch(text)
    if match is None:
        raise refused(file, line, f"{shown(text)} is not a string", "put it into double quotes")
    return _QUOTE.sub('"', match[1])

"""Chosen values in a given file of calibration data: all else stays as it is."""

import math
import re
from bisect import bisect
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape  # writes only

from drivecal.calibration_data import cdfx, dcm, files
from drivecal.calibration_data.characteristics import INDEX, Characteristic, decoded, other_units, quoted
from drivecal.calibration_data.sections import AXES, SINGLE, joined
from drivecal.contracts.input_errors import nearest
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem, file_faults

_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_ORIGIN = {
    "dcm": re.compile(rb"^\* state: (?:calibrated|prelimCalibrated)\r?\n\* date: .*\n(?:\* .+: .*\n)*", re.MULTILINE),
    "cdfx": re.compile(rb"<CS-ENTRY>(?:(?!</CS-ENTRY>).)*<CSUS>drivecal</CSUS>.*?</CS-ENTRY>", re.DOTALL),
}
_Edit = tuple[int, int, str]  # begin, end and new text of what changes


def carried(base: Path, form: files.CalibrationFormat, chosen: Sequence[Characteristic], written: bytes = b"") -> bytes:
    """Returns the content of a base file with chosen values. A DCM or CDFX keeps every other byte but an origin that drivecal wrote, which
    becomes that of the `written` file of these values; in another format, and of an A2L, what drivecal reads is written. Raises
    InvalidInputError for values that do not fit the base."""
    file, ending = base.name, base.suffix.lower().removeprefix(".")
    with file_faults(base, "read", "give a DCM, CDFX or A2L file"):
        held = base.read_bytes()
    if ending != form:
        known = {each.name: each for each in joined([files.read(held, file).characteristics])}
        return files.write(form, [each for each in replaced(known, chosen, file).values() if each.given is not None], None)
    if b"\0" in held[:64]:
        raise InvalidInputError(Problem(shown(file, 200), "its encoding is not one of single bytes", "save as UTF-8"))
    mark = _BYTE_ORDER_MARK if held.startswith(_BYTE_ORDER_MARK) else b""
    body = held.removeprefix(mark)
    content = dcm.read_text(body.decode("latin-1"), file) if ending == "dcm" else cdfx.read(body, file)  # places count bytes
    read = content.characteristics
    if ending == "dcm":  # whose texts have the file's own encoding
        read = [_placed(own, each) for own, each in zip(dcm.read(body, file).characteristics, read, strict=True)]
    known = {each.name: each for each in joined([read])}
    changed = replaced(known, chosen, file)
    names = {each.name for each in chosen} | {name for name, each in known.items() if changed[name] != each}
    edits = [*_edits(known, changed, ending, body), *_origins(known, names, ending, body, written)]
    pieces, end = [mark], 0
    for begin, last, text in sorted(edits):
        if ending == "dcm" and not text.isascii() and decoded(held, file).encode() != body:
            raise InvalidInputError(Problem(shown(file, 200), f"it is not UTF-8, as {shown(text)} would be", "save as UTF-8"))
        pieces += [body[end:begin], text.encode("ascii", "xmlcharrefreplace") if ending == "cdfx" else text.encode()]
        end = last
    return b"".join([*pieces, body[end:]])


def _placed(own: Characteristic, counted: Characteristic) -> Characteristic:
    axes = tuple(replace(axis, places=other.places) for axis, other in zip(own.axes, counted.axes, strict=True))
    return replace(own, axes=axes, places=counted.places)


def _origins(
    known: Mapping[str, Characteristic], names: Collection[str], form: str, body: bytes, written: bytes
) -> Iterator[_Edit]:
    """Yields the new origin for each that drivecal wrote, in a CDFX only of the instances `names`: earlier sets gave the others."""
    origin = _ORIGIN[form].search(written)
    if origin is None:
        return
    lines = origin[0].replace(b"\r\n", b"\n").decode()
    starts = sorted((each.places[0][0], name) for name, each in known.items() if each.places)
    for held in _ORIGIN[form].finditer(body):
        owner = bisect(starts, (held.start(), ""))
        if form == "dcm" or (owner and starts[owner - 1][1] in names):
            yield held.start(), held.end(), lines.replace("\n", "\r\n") if b"\r\n" in held[0] else lines


def _edits(
    known: Mapping[str, Characteristic], changed: Mapping[str, Characteristic], form: str, body: bytes
) -> Iterator[_Edit]:
    for name, old in known.items():
        new = changed[name]
        pairs = [(old.values or (old.value,), new.values or (new.value,), old.places)]
        pairs += [(before.points, after.points, before.places) for before, after in zip(old.axes, new.axes, strict=True)]
        for was, given, places in pairs:
            for before, after, (begin, end) in zip(was, given, places, strict=False):
                text = after if isinstance(after, str) else repr(after)
                if not isinstance(after, str) and body[begin:end].lstrip(b"+-").isdigit():
                    text = text.removesuffix(".0")
                if before != after:
                    yield begin, end, escape(text) if form == "cdfx" else quoted(text) if isinstance(after, str) else text


def replaced(known: Mapping[str, Characteristic], chosen: Sequence[Characteristic], file: str) -> dict[str, Characteristic]:
    """Returns the known characteristics by name, with the chosen values. `gain.x` has the points of the first axis of `gain`; a shared
    axis gives its points to its curves, too. Raises InvalidInputError for what is unknown or has other axes."""
    given = {each.name: each for each in chosen}
    problems, unknown, result = [], set(given), dict[str, Characteristic]()
    for name, old in known.items():
        new, axes = _coded(old, given.get(name, old)), []
        fits = name not in given or _fits(old, new, given)
        for letter, axis, own in zip(AXES, old.axes, new.axes, strict=False):
            moved = given.get(f"{name}.{letter}", given.get(axis.shared))
            held = axis.points if old.values else ()
            points = moved.values if moved and axis.points else held or own.points
            fits = fits and (not held or len(points) == len(held))
            axes.append(replace(axis, points=points))
            unknown.discard(f"{name}.{letter}")
        if not fits:
            message = f"{shown(file, 200)} has another kind, number or axis of its values than the problem"
            problem = Problem(shown(name), message, "give a file that belongs to the problem's version")
            if isinstance(old.value, float) and isinstance(new.value, str):
                message = f"{shown(file, 200)} has the number of a choice, and no text"
                problem = Problem(shown(name), message, "give a base with the text (TEXT of a DCM, VT of a CDFX)")
            problems.append(old.fault or problem)
        remedy, differing = "give a base in the problem's units, or write them alike", other_units(old, new) if fits else ()
        problems += [Problem(shown(name), f"{shown(file, 200)} has {each}", remedy) for each in differing]
        result[name] = replace(old, value=new.value, values=new.values, axes=tuple(axes))
    missing, free = f"{shown(file, 200)} does not have it", [name for name in known if name not in given]
    problems += [
        Problem(shown(name), missing, nearest(name, free) if free else "give a base that has it")
        for name in sorted(unknown - known.keys())
    ]
    if problems:
        raise InvalidInputError(*problems)
    return result


def _coded(old: Characteristic, new: Characteristic) -> Characteristic:
    """Returns a chosen text as a number if the file has the number, and says what it stands for."""
    codes = dict[Any, float](zip(old.choices, old.codes, strict=False))
    return replace(new, value=codes.get(new.value, new.value)) if isinstance(old.value, float) else new


def _fits(old: Characteristic, new: Characteristic, given: Mapping[str, Characteristic]) -> bool:
    """Returns True if a file's characteristic can take values. An A2L has no values, and no axes of its own; `given` axes may move."""
    points = list[tuple[float, float]]()
    for letter, one, other in zip(AXES, old.axes, new.axes, strict=False):
        is_free = INDEX in {one.kind, other.kind} or given.keys() & {f"{old.name}.{letter}", one.shared}
        points += [] if is_free else zip(one.points, other.points, strict=False)
    same_points = all(math.isclose(one, other, rel_tol=SINGLE, abs_tol=SINGLE) for one, other in points)
    same_size = len(old.axes) == len(new.axes) and (not old.values or len(old.values) == len(new.values))
    same_kind = old.value is None or isinstance(old.value, str) == isinstance(new.value, str)
    return old.fault is None and same_size and same_kind and same_points

"""A2L (ASAM MCD-2 MC, ASAP2): names, limits, units, resolutions and axes of a control unit's characteristics. It holds no values, and only
the fixed points of axes: the others stand in the control unit's memory.
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile

from drivecal.calibration_data.characteristics import (
    Axis,
    Characteristic,
    Content,
    decoded,
    extents,
    index,
    problem_of,
    refused,
    unit_of,
)
from drivecal.contracts.strict_json import shown

_TOKEN = re.compile(
    r"""\s+ | /\*.*?\*/ | //[^\n]*
      | (?P<string>"(?:[^"\\]|\\.|"")*")
      | (?P<word>(?:(?!/\*|//)[^\s"])+)
      | (?P<other>.)""",
    re.VERBOSE | re.DOTALL,
)
_ESCAPE = re.compile(r'\\(.)|""', re.DOTALL)
_WHOLE = re.compile(r"U?(?:BYTE|WORD|LONG)|SBYTE|SWORD|SLONG|A_U?INT64")
_IDENTICAL = "NO_COMPU_METHOD"
_FOLLOWING = frozenset({"DEPENDENT_CHARACTERISTIC", "VIRTUAL_CHARACTERISTIC"})
"""Blocks of characteristics that follow from others."""
_NO_ACCESS = frozenset({"NO_CALIBRATION", "NOT_IN_MCD_SYSTEM"})
_AXES = {"VALUE": 0, "CURVE": 1, "MAP": 2, "VAL_BLK": 1}
"""Least number of axes of each kind."""


@dataclass(frozen=True, slots=True)
class _Token:
    text: str
    line: int
    is_string: bool = False


@dataclass(slots=True)
class _Block:
    """Content between `/begin KIND` and `/end KIND`, and the blocks inside apart from it."""

    kind: str
    line: int
    module: int = 0
    """Number of the MODULE around it, whose names are its own."""
    tokens: list[_Token] = field(default_factory=list)
    inside: "list[_Block]" = field(default_factory=list)
    """Not of a whole project or module."""

    def text(self, position: int) -> str:
        return self.tokens[position].text if position < len(self.tokens) else ""

    def is_fixed(self) -> bool:
        """Returns whether a characteristic or axis follows from others, or cannot be calibrated."""
        words = {token.text for token in self.tokens[9:] if not token.is_string}
        access = self.after("CALIBRATION_ACCESS", 9)[:1]
        return "READ_ONLY" in words or not _NO_ACCESS.isdisjoint(access) or any(each.kind in _FOLLOWING for each in self.inside)

    def after(self, keyword: str, first: int) -> list[str]:
        """Returns the texts behind a keyword, at position `first` or later; empty if it is missing."""
        for position in range(first, len(self.tokens)):
            if self.tokens[position].text == keyword and not self.tokens[position].is_string:
                return [token.text for token in self.tokens[position + 1 : position + 8]]
        return []


_Described = dict[tuple[int, str, str], _Block]
"""Blocks that describe values, by module, kind and name."""


def read(content: bytes, file: str) -> Content:
    """Returns the characteristics of types VALUE, CURVE, MAP and VAL_BLK, and the axes that curves share (COM_AXIS). Raises
    InvalidInputError with the line of the first fault that concerns all of them."""
    described: _Described = {}
    wanted: list[_Block] = []
    result = Content()
    for block in _blocks(decoded(content, file), file):
        if block.kind in {"CHARACTERISTIC", "AXIS_PTS"} and block.is_fixed():
            result.fixed.add(block.text(0))
        if block.kind == "CHARACTERISTIC":
            if block.text(2) in _AXES and not block.is_fixed():
                wanted.append(block)
            else:
                result.skipped.append(block.text(0))
        elif block.kind == "INSTANCE":
            result.skipped.append(block.text(0))
        elif block.kind in {"COMPU_METHOD", "COMPU_VTAB", "COMPU_VTAB_RANGE", "RECORD_LAYOUT", "AXIS_PTS"}:
            described[block.module, block.kind, block.text(0)] = block
    shared: dict[str, _Block] = {}
    for block in wanted:
        characteristic = _characteristic(block, block.text(2), described, file)
        axes = tuple(_axes(block, described))
        for points in [described.get((block.module, "AXIS_PTS", axis.shared)) for axis in axes if axis.kind == "COM_AXIS"]:
            if points is not None and shared.setdefault(points.text(0), points) is not points:
                message = f"its axis {shown(points.text(0))} has the name of another module's, and other files name no module"
                fault = problem_of(file, block.line, message, "export each MODULE alone, or leave it out by --match")
                characteristic = replace(characteristic, fault=fault)
        is_known = _AXES[characteristic.kind] <= len(axes) <= 2
        result.add(file, characteristic.name, replace(characteristic, axes=axes) if is_known else None)
    for name, points in [(name, points) for name, points in shared.items() if name not in result.names]:
        axis = None if points.is_fixed() else _characteristic(points, "COM_AXIS", described, file)
        result.add(file, name, axis and replace(axis, axes=(index(_count(points.text(7))),)))
    return result


def _tokens(text: str, file: str) -> Iterator[_Token]:
    line = 1
    for match in _TOKEN.finditer(text):
        kind, token = match.lastgroup, match.group()
        if kind == "word":
            yield _Token(token, line)
        elif kind == "string":
            yield _Token(_ESCAPE.sub(lambda part: part[1] or '"', token[1:-1]), line, is_string=True)
        elif kind == "other":
            raise refused(file, line, "a string has no end", "close it by a double quote")
        line += token.count("\n")


def _blocks(text: str, file: str) -> Iterator[_Block]:
    """Yields all blocks, each when it ends."""
    is_a2l, module = False, 0
    open_blocks: list[_Block] = []
    tokens = _tokens(text, file)
    for token in tokens:
        if token.is_string or token.text not in {"/begin", "/end", "/include"}:
            if open_blocks:
                open_blocks[-1].tokens.append(token)
            continue
        name = next(tokens, _Token("", token.line))
        if token.text == "/include":
            if name.text.lower().endswith(".aml") or any(block.kind == "A2ML" for block in open_blocks):
                continue  # describes interfaces, not characteristics
            raise refused(file, token.line, f"it includes {shown(name.text)}", "export it as one file")
        if token.text == "/begin":
            is_a2l = is_a2l or name.text == "PROJECT"
            module += name.text == "MODULE"
            block = _Block(name.text, token.line, module)
            if open_blocks and open_blocks[-1].kind not in {"PROJECT", "MODULE"}:
                open_blocks[-1].inside.append(block)
            open_blocks.append(block)
        elif not open_blocks or open_blocks[-1].kind != name.text:
            expected = f"of {open_blocks[-1].kind} (line {open_blocks[-1].line})" if open_blocks else "of no block"
            raise refused(file, token.line, f"/end {shown(name.text)} stands at the end {expected}", "correct the file")
        else:
            yield open_blocks.pop()
    if open_blocks:
        raise refused(file, open_blocks[-1].line, f"{shown(open_blocks[-1].kind)} has no /end", "complete the file")
    if not is_a2l:
        raise refused(file, 1, "it has no /begin PROJECT", "give an A2L file")


def _characteristic(block: _Block, kind: str, described: _Described, file: str) -> Characteristic:
    """Reads: name, description, type, address, deposit, largest difference, conversion, lower and upper limit, then optional fields. An
    axis has its input and record layout in the places of address and deposit, and the number of its points before the limits."""
    first = 8 if kind == "COM_AXIS" else 7
    if len(block.tokens) < first + 2:
        raise refused(file, block.line, f"the characteristic {shown(block.text(0))} is incomplete", "export the file again")
    name, conversion = block.text(0), block.text(6)
    lower, upper = _limit(block.text(first)), _limit(block.text(first + 1))
    method = described.get((block.module, "COMPU_METHOD", conversion))
    fault = None
    for token, limit in zip(block.tokens[first:], (lower, upper), strict=False):
        if math.isnan(limit):
            remedy = f"correct the limit of {shown(name)}, or leave it out by --match"
            fault = problem_of(file, token.line, f"{shown(token.text)} is not a number", remedy)
    remedy = "export the file again, or leave it out by --match"
    if method is None and conversion != _IDENTICAL:
        fault = problem_of(file, block.tokens[6].line, f"there is no COMPU_METHOD {shown(conversion)}", remedy)
    word, needed = {"LINEAR": ("COEFFS_LINEAR", 2), "RAT_FUNC": ("COEFFS", 6)}.get(method.text(2) if method else "", ("", 0))
    if method is not None and len(_numbers(method.after(word, 5)[:needed])) < needed:
        fault = problem_of(file, method.line, f"COMPU_METHOD {shown(conversion)} has no {needed} numbers after {word}", remedy)
    layout = described.get((block.module, "RECORD_LAYOUT", block.text(4)))
    values = "AXIS_PTS_X" if kind == "COM_AXIS" else "FNC_VALUES"
    stored = next((text for text in (layout.after(values, 1)[1:2] if layout is not None else ()) if _WHOLE.fullmatch(text)), "")
    choices: dict[str, float] = {}
    if method is not None and method.text(2) == "TAB_VERB":
        choices, message, remedy = _choices(method, described, lower, upper)
        if message:
            fault = problem_of(file, block.tokens[6].line, message, remedy)
    raster = _raster(method) if stored else None
    given = _numbers(block.after("STEP_SIZE", 9)[:1])
    step = given[0] if given and given[0] > 0 else None if raster is None else raster.step
    is_integer = raster is not None and not choices and step == raster.step == 1.0 and raster.offset.is_integer()
    if raster is not None and step == raster.step and not choices and math.isfinite(lower):
        lower = raster.first_from(lower)
    return Characteristic(
        name,
        unit=_unit(block, method),
        description=" ".join(block.text(1).split()),
        lower=lower if math.isfinite(lower) else None,
        upper=upper if math.isfinite(upper) else None,
        step=None if choices or is_integer else step,
        integer=is_integer,
        choices=tuple(choices),
        codes=tuple(choices.values()),
        line=block.line,
        fault=fault,
        note=_beyond(raster, stored, _numbers(block.after("BIT_MASK", 9)[:1]), lower, upper) if raster else "",
        kind=kind,
    )


def _beyond(raster: "_Raster", stored: str, mask: list[float], lower: float, upper: float) -> str:
    """Returns a note on limits that whole numbers of type `stored`, or the bits of a mask in it, cannot express; empty if they can."""
    bits = next(bits for name, bits in (("BYTE", 8), ("WORD", 16), ("LONG", 32), ("INT64", 64)) if stored.endswith(name))
    is_signed = "U" not in stored
    if mask and (masked := int(abs(mask[0])).bit_count()) < bits:  # they are a number without a sign
        bits, is_signed, stored = masked, False, f"the {masked} bits of its BIT_MASK"
    ends = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if is_signed else (0, 2**bits - 1)
    least, most = sorted(raster.offset + raster.sign * raster.step * end for end in ends)
    fits = least - raster.step < lower and upper < most + raster.step
    return "" if fits else f"its limits {lower:g} to {upper:g} exceed what {stored} can express, {least:g} to {most:g}"


def _unit(block: _Block, method: _Block | None) -> str:
    return unit_of(next(iter(block.after("PHYS_UNIT", 6)), method.text(4) if method else ""))


def _axes(block: _Block, described: _Described) -> Iterator[Axis]:
    """Yields the axes of a characteristic: an array's are numbered; a curve's have kind, input, conversion, largest number of points, lower
    and upper limit, then optional fields. An axis that is a curve itself is missing."""
    if block.text(2) == "VAL_BLK":
        sizes = [*takewhile(bool, map(_count, block.after("MATRIX_DIM", 9)[:3] or block.after("NUMBER", 9)[:1]))]
        yield from map(index, extents(sizes))
    for axis in (each for each in block.inside if each.kind == "AXIS_DESCR"):
        kind = axis.text(0)
        method = described.get((block.module, "COMPU_METHOD", axis.text(2)))
        lower, upper = (limit if math.isfinite(limit) else None for limit in map(_limit, (axis.text(4), axis.text(5))))
        points: tuple[float, ...] = ()
        if kind == "FIX_AXIS" and (method or axis.text(2) == _IDENTICAL) and (raster := _raster(method)) is not None:
            points = tuple(raster.offset + raster.sign * raster.step * stored for stored in _fixed(axis))
        if kind != "CURVE_AXIS":
            unit = "1" if kind == "RES_AXIS" else _unit(axis, method)  # its points are positions in a table
            yield Axis(kind, points, unit, next(iter(axis.after("AXIS_PTS_REF", 6)), ""), lower, upper)


def _fixed(axis: _Block) -> Iterator[float]:
    """Yields the points of a fixed axis as they are stored."""
    for listed in axis.inside:
        yield from _numbers([token.text for token in listed.tokens]) if listed.kind == "FIX_AXIS_PAR_LIST" else ()
    for keyword in ("FIX_AXIS_PAR", "FIX_AXIS_PAR_DIST"):
        if given := _numbers(axis.after(keyword, 6)[:3]):
            distance = 2.0 ** min(given[1], 99.0) if keyword == "FIX_AXIS_PAR" else given[1]
            yield from (given[0] + number * distance for number in range(_count(f"{given[2]:.0f}")))


def _count(text: str) -> int:
    """Returns a number of points; 0 if it is none."""
    return int(text) if text.isdecimal() and len(text) < 5 else 0


def _choices(method: _Block, described: _Described, lower: float, upper: float) -> tuple[dict[str, float], str, str]:
    """Returns the texts of an enumeration's values within the limits, with their numbers; or else what is wrong, and the remedy."""
    remedy = "export the file again, or leave it out by --match"
    name = next(iter(method.after("COMPU_TAB_REF", 5)), "")
    table, ranges = (described.get((method.module, kind, name)) for kind in ("COMPU_VTAB", "COMPU_VTAB_RANGE"))
    if table is None and ranges is None:
        return {}, f"there is no COMPU_VTAB {shown(name)}, which COMPU_METHOD {shown(method.text(0))} names", remedy
    texts: dict[str, float] = {}
    for first, last, text in _rows(table, 4, 1) if table is not None else _rows(ranges, 3, 2):
        if last < lower or first > upper:
            continue
        if first != last:
            message = f"{shown(text)} of {shown(name)} stands for all values from {first:g} to {last:g}"
            return {}, message, "give it a single value, or leave the characteristic out by --match"
        texts.setdefault(text, first)
    return texts, "" if texts else f"{shown(name)} has no text for a value from {lower:g} to {upper:g}", remedy


def _rows(table: _Block | None, first: int, n_values: int) -> Iterator[tuple[float, float, str]]:
    """Yields least value, largest value and text of the rows of a COMPU_VTAB or COMPU_VTAB_RANGE, which begin at a position."""
    tokens = table.tokens[first:] if table is not None else []
    for row in zip(*(tokens[position :: n_values + 1] for position in range(n_values + 1)), strict=False):
        if row[-1].is_string and (values := _numbers([token.text for token in row[:-1]])):
            yield values[0], values[-1], row[-1].text


@dataclass(frozen=True, slots=True)
class _Raster:
    """Physical values that whole numbers stand for: `offset` and all multiples of `step` from it; with `sign` that of the number."""

    step: float
    offset: float = 0.0
    sign: float = 1.0

    def first_from(self, lower: float) -> float:
        """Returns the least value of the raster that is not below a limit."""
        count = (lower - self.offset) / self.step
        if not math.isfinite(count):
            return lower
        return lower if abs(count - round(count)) <= 1e-6 else self.offset + math.ceil(count) * self.step


def _raster(method: _Block | None) -> _Raster | None:
    """Returns the raster of whole numbers, which are stored as they are without a method; None if the conversion is not linear."""
    if method is None or method.text(2) == "IDENTICAL":
        return _Raster(1.0)
    if method.text(2) == "LINEAR":  # physical = a stored + b
        factors = _numbers(method.after("COEFFS_LINEAR", 5)[:2])
        return _Raster(abs(factors[0]), factors[1], math.copysign(1, factors[0])) if len(factors) == 2 and factors[0] else None
    if method.text(2) == "RAT_FUNC":  # stored = (a x^2 + b x + c) / (d x^2 + e x + f)
        factors = _numbers(method.after("COEFFS", 5)[:6])
        a, b, c, d, e, f = factors if len(factors) == 6 else [0.0] * 6
        return _Raster(abs(f / b), -c / b, math.copysign(1, f / b)) if a == d == e == 0 and b != 0 and f != 0 else None
    return None


def _numbers(texts: Sequence[str]) -> list[float]:
    """Returns the numbers of texts; an empty list if a text is not a number."""
    numbers = [_limit(text) for text in texts]
    return numbers if all(map(math.isfinite, numbers)) else []


def _limit(text: str) -> float:
    """Returns a limit, decimal or hexadecimal; infinite if it is beyond all numbers, NaN if it is none."""
    try:
        return float(int(text, 16)) if text.lower().startswith("0x") else float(text)
    except (ValueError, OverflowError):
        return math.nan

"""A2L (ASAM MCD-2 MC, ASAP2): names, limits, units and resolutions of a control unit's scalar characteristics. It holds no values."""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from drivecal.calibration_data.characteristics import Characteristic, Content, decoded, problem_of, refused, unit_of
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


@dataclass(frozen=True, slots=True)
class _Token:
    text: str
    line: int
    is_string: bool = False


@dataclass(slots=True)
class _Block:
    """Content between `/begin KIND` and `/end KIND`, without the blocks inside, but with their kinds."""

    kind: str
    line: int
    module: int = 0
    """Number of the MODULE around it, whose names are its own."""
    tokens: list[_Token] = field(default_factory=list)
    inside: set[str] = field(default_factory=set)

    def text(self, position: int) -> str:
        return self.tokens[position].text if position < len(self.tokens) else ""

    def has(self, keyword: str) -> bool:
        return any(token.text == keyword and not token.is_string for token in self.tokens[9:])

    def after(self, keyword: str, first: int) -> list[str]:
        """Returns the texts behind a keyword, at position `first` or later; empty if it is missing."""
        for position in range(first, len(self.tokens)):
            if self.tokens[position].text == keyword and not self.tokens[position].is_string:
                return [token.text for token in self.tokens[position + 1 : position + 8]]
        return []


@dataclass(slots=True)
class _Described:
    """Blocks that describe values, by module, kind and name."""

    blocks: dict[tuple[int, str, str], _Block] = field(default_factory=dict)

    def get(self, module: int, kind: str, name: str) -> _Block | None:
        return self.blocks.get((module, kind, name))


def read(content: bytes, file: str) -> Content:
    """Returns the characteristics of type VALUE. Raises InvalidInputError with the line of the first fault that concerns all of them."""
    described = _Described()
    wanted: list[_Block] = []
    result = Content()
    for block in _blocks(decoded(content, file), file):
        if block.kind == "CHARACTERISTIC":
            if block.text(2) == "VALUE" and not block.inside & _FOLLOWING and not block.has("READ_ONLY"):
                wanted.append(block)
            else:
                result.skipped.append(block.text(0))
        elif block.kind == "INSTANCE":
            result.skipped.append(block.text(0))
        elif block.kind in {"COMPU_METHOD", "COMPU_VTAB", "COMPU_VTAB_RANGE", "RECORD_LAYOUT"}:
            described.blocks[block.module, block.kind, block.text(0)] = block
    names: set[str] = set()
    for block in wanted:
        characteristic = _characteristic(block, described, file)
        result.add(file, characteristic, names)
        names.add(characteristic.name)
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
            if open_blocks:
                open_blocks[-1].inside.add(name.text)
            open_blocks.append(_Block(name.text, token.line, module))
        elif not open_blocks or open_blocks[-1].kind != name.text:
            expected = f"of {open_blocks[-1].kind} (line {open_blocks[-1].line})" if open_blocks else "of no block"
            raise refused(file, token.line, f"/end {shown(name.text)} stands at the end {expected}", "correct the file")
        else:
            yield open_blocks.pop()
    if open_blocks:
        raise refused(file, open_blocks[-1].line, f"{shown(open_blocks[-1].kind)} has no /end", "complete the file")
    if not is_a2l:
        raise refused(file, 1, "it has no /begin PROJECT", "give an A2L file")


def _characteristic(block: _Block, described: _Described, file: str) -> Characteristic:
    """Reads: name, description, type, address, deposit, largest difference, conversion, lower and upper limit, then optional fields."""
    if len(block.tokens) < 9:
        raise refused(file, block.line, f"the characteristic {shown(block.text(0))} is incomplete", "export the file again")
    name, conversion = block.text(0), block.text(6)
    lower, upper = _limit(block.text(7)), _limit(block.text(8))
    method = described.get(block.module, "COMPU_METHOD", conversion)
    fault = None
    for token, limit in ((block.tokens[7], lower), (block.tokens[8], upper)):
        if math.isnan(limit):
            remedy = f"correct the limit of {shown(name)}, or leave it out by --match"
            fault = problem_of(file, token.line, f"{shown(token.text)} is not a number", remedy)
    if method is None and conversion != _IDENTICAL:
        message, remedy = f"there is no COMPU_METHOD {shown(conversion)}", "export the file again, or leave it out by --match"
        fault = problem_of(file, block.tokens[6].line, message, remedy)
    layout = described.get(block.module, "RECORD_LAYOUT", block.text(4))
    is_whole = layout is not None and any(_WHOLE.fullmatch(text) for text in layout.after("FNC_VALUES", 1)[1:2])
    unit = next(iter(block.after("PHYS_UNIT", 9)), method.text(4) if method else "")
    choices: dict[str, float] = {}
    if method is not None and method.text(2) == "TAB_VERB":
        choices, message, remedy = _choices(method, described, lower, upper)
        if message:
            fault = problem_of(file, block.tokens[6].line, message, remedy)
    raster = _raster(method) if is_whole else None
    given = [float(text) for text in block.after("STEP_SIZE", 9)[:1] if _is_number(text)]
    step = given[0] if given and given[0] > 0 else None if raster is None else raster.step
    is_integer = raster is not None and not choices and step == raster.step == 1.0 and raster.offset.is_integer()
    if raster is not None and step == raster.step and not choices and math.isfinite(lower):
        lower = raster.first_from(lower)
    return Characteristic(
        name,
        unit=unit_of(unit),
        description=" ".join(block.text(1).split()),
        lower=lower if math.isfinite(lower) else None,
        upper=upper if math.isfinite(upper) else None,
        step=None if choices or is_integer else step,
        integer=is_integer,
        choices=tuple(choices),
        codes=tuple(choices.values()),
        line=block.line,
        fault=fault,
    )


def _choices(method: _Block, described: _Described, lower: float, upper: float) -> tuple[dict[str, float], str, str]:
    """Returns the texts of an enumeration's values within the limits, with their numbers; or else what is wrong, and the remedy."""
    remedy = "export the file again, or leave it out by --match"
    name = next(iter(method.after("COMPU_TAB_REF", 5)), "")
    table, ranges = (described.get(method.module, kind, name) for kind in ("COMPU_VTAB", "COMPU_VTAB_RANGE"))
    if table is None and ranges is None:
        return {}, f"there is no COMPU_VTAB {shown(name)}, which COMPU_METHOD {shown(method.text(0))} names", remedy
    texts: dict[str, float] = {}
    for first, last, text in _rows(table) if table is not None else _triples(ranges):
        if last < lower or first > upper:
            continue
        if first != last:
            message = f"{shown(text)} of {shown(name)} stands for all values from {first:g} to {last:g}"
            return {}, message, "give it a single value, or leave the characteristic out by --match"
        texts.setdefault(text, first)
    return texts, "" if texts else f"{shown(name)} has no text for a value from {lower:g} to {upper:g}", remedy


def _rows(table: _Block) -> Iterator[tuple[float, float, str]]:
    """Yields value, value and text of a COMPU_VTAB's rows."""
    for value, text in zip(table.tokens[4::2], table.tokens[5::2], strict=False):
        if text.is_string and _is_number(value.text):
            yield float(value.text), float(value.text), text.text


def _triples(table: _Block | None) -> Iterator[tuple[float, float, str]]:
    """Yields least value, largest value and text of a COMPU_VTAB_RANGE's rows."""
    tokens = table.tokens if table is not None else []
    for first, last, text in zip(tokens[3::3], tokens[4::3], tokens[5::3], strict=False):
        if text.is_string and _is_number(first.text) and _is_number(last.text):
            yield float(first.text), float(last.text), text.text


@dataclass(frozen=True, slots=True)
class _Raster:
    """Physical values that whole numbers stand for: `offset` and all multiples of `step` from it."""

    step: float
    offset: float = 0.0

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
        return _Raster(abs(factors[0]), factors[1]) if len(factors) == 2 and factors[0] else None
    if method.text(2) == "RAT_FUNC":  # stored = (a x^2 + b x + c) / (d x^2 + e x + f)
        factors = _numbers(method.after("COEFFS", 5)[:6])
        if len(factors) < 6:
            return None
        a, b, c, d, e, f = factors
        return _Raster(abs(f / b), -c / b) if a == d == e == 0 and b != 0 and f != 0 else None
    return None


def _numbers(texts: Sequence[str]) -> list[float]:
    """Returns the numbers of texts; an empty list if a text is not a number."""
    return [float(text) for text in texts] if all(map(_is_number, texts)) else []


def _limit(text: str) -> float:
    """Returns a limit, decimal or hexadecimal; infinite if it is beyond all numbers, NaN if it is none."""
    try:
        return float(int(text, 16)) if text.lower().startswith("0x") else float(text)
    except (ValueError, OverflowError):
        return math.nan


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False

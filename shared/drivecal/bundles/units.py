"""Units as texts. Compares units that are equal and written differently, such as m/s², m/s^2, m/s2 and m.s-2."""

import math
import re
from collections import Counter
from collections.abc import Mapping

_CHARACTERS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹\u00b5\u2126\u212a\u2212\u22c5\u2219", "-0123456789\u03bc\u03a9K-\u00b7\u00b7")
"""Superscripts, and the other code points of micro, ohm, kelvin, minus and the dot."""
_FACTOR = re.compile(r"([/.*·]?)([^\W\d_]+|[%°]\w*|1)(?:(?:\^|\*\*)?(?:\((-?\d{1,2})\)|(-?\d{1,2})))?")
_ANGLE = re.compile("rad|deg|°")
_GROUP = re.compile(r"/\(([^()/]+)\)")
LONGEST = 200
"""Characters of a unit that is read: files of others have any number of spaces."""
WITHOUT = frozenset({"", "-", "1"})
_SIZES = {
    "m": (1.0, "m"), "kmh": (1 / 3.6, "m/s"), "mph": (0.44704, "m/s"), "g": (1e-3, "kg"), "t": (1e3, "kg"), "A": (1.0, "A"),
    "K": (1.0, "K"), "s": (1.0, "s"), "min": (60.0, "s"), "h": (3600.0, "s"), "Hz": (1.0, "U/s"), "rpm": (1 / 60, "U/s"), "U": (1.0, "U"),
    "%": (0.01, "1"), "rad": (1.0, "1"), "deg": (math.pi / 180, "1"), "°": (math.pi / 180, "1"), "N": (1.0, "kg.m/s2"),
    "Ns": (1.0, "kg.m/s"), "Nm": (1.0, "kg.m2/s2"), "J": (1.0, "kg.m2/s2"), "Ws": (1.0, "kg.m2/s2"), "Wh": (3600.0, "kg.m2/s2"),
    "W": (1.0, "kg.m2/s3"), "Pa": (1.0, "kg/m/s2"), "bar": (1e5, "kg/m/s2"), "V": (1.0, "kg.m2/s3/A"), "\u03a9": (1.0, "kg.m2/s3/A2"),
    "As": (1.0, "A.s"), "Ah": (3600.0, "A.s"), "Ohm": (1.0, "kg.m2/s3/A2"), "sec": (1.0, "s"), "°C": (1.0, "°C"), "degC": (1.0, "°C"),
}  # fmt: skip
"""Sizes of symbols in base units. `U` counts revolutions, which agree with 1, but not with an angle."""
_PREFIXES = {"": 1.0, "k": 1e3, "M": 1e6, "h": 1e2, "d": 1e-1, "c": 1e-2, "m": 1e-3, "\u03bc": 1e-6, "n": 1e-9}
_BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
"""Base units of FMI."""


def powers(unit: str) -> Mapping[str, int] | None:
    """Returns the power of each symbol of a unit, e.g. m: 1 and s: -2; radians count as 1. None if the text is no product of
    powers, or longer than `LONGEST`."""
    if len(unit) > LONGEST:
        return None
    text = "" if unit.strip() in WITHOUT else unit.strip().translate(_CHARACTERS)
    text = _GROUP.sub(lambda match: "/" + re.sub(r"[.*· ]", "/", match[1].replace("**", "^")), text)
    text = re.sub(r"\s*([/*·.])\s*", r"\1", text).replace(" ", ".")
    counted: dict[str, int] = {}
    position = 0
    while position < len(text):
        match = _FACTOR.match(text, position)
        if match is None or (position == 0 and match[1]) or (position > 0 and not match[1]):
            return None
        power = int(match[3] or match[4] or 1) * (-1 if match[1] == "/" else 1)
        counted[match[2]] = counted.get(match[2], 0) + power
        position = match.end()
    return {symbol: power for symbol, power in counted.items() if power and symbol not in {"1", "rad"}}


def same(unit: str, other: str) -> bool:
    """Returns whether two texts are the same unit."""
    counted = powers(unit), powers(other)
    if None in counted:
        return unit.translate(_CHARACTERS) == other.translate(_CHARACTERS)
    return counted[0] == counted[1]


def agree(unit: str, other: str) -> bool | None:
    """Returns whether two texts are units of one size, such as N·s and Ns, or 1/min and rpm; None if a symbol is unknown. A missing unit
    agrees with any, as files may lack it."""
    if {unit.strip(), other.strip()} & WITHOUT or same(unit, other):
        return True
    one, another = _size(unit), _size(other)
    if one is None or another is None:
        return None
    counts = one[1].pop("U", 0) == another[1].pop("U", 0) or not any(map(_ANGLE.search, (unit, other)))
    return counts and one[1] == another[1] and math.isclose(one[0], another[0], rel_tol=1e-6)


def _size(unit: str) -> tuple[float, Counter[str]] | None:
    """Returns the factor and the powers of a unit in base units; None if a symbol is unknown."""
    counted, size, total = powers(unit), 1.0, Counter[str]()
    for symbol, power in () if counted is None else counted.items():
        prefix = next((each for each in _PREFIXES if symbol.startswith(each) and symbol.removeprefix(each) in _SIZES), None)
        if prefix is None:
            return None
        factor, base = _SIZES[symbol.removeprefix(prefix)]
        size *= (_PREFIXES[prefix] * factor) ** power
        total.update({name: times * power for name, times in (powers(base) or {}).items()})
    return None if counted is None else (size, total)


def spellings(stated: str | None, base: Mapping[str, float] | None) -> tuple[str, ...]:
    """Returns the unit that an FMU states, also as a product of base units; nothing if it states none, or 1, as some tools do of every
    variable.

    `base`: powers of the base units, with `factor` and `offset`, as the FMU defines the unit.
    """
    if not stated or stated in WITHOUT:
        return ()
    if base is None or base.get("factor", 1.0) != 1.0 or base.get("offset", 0.0) != 0.0:
        return (stated,)
    return (stated, ".".join(f"{symbol}{int(base.get(symbol, 0))}" for symbol in _BASE))

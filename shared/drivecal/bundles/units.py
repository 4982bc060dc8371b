"""Units as texts. Compares units that are equal and written differently, such as m/s², m/s^2, m/s2 and m.s-2."""

import re
from collections.abc import Mapping

_CHARACTERS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹\u00b5\u2126\u212a\u2212\u22c5\u2219", "-0123456789\u03bc\u03a9K-\u00b7\u00b7")
"""Superscripts, and the other code points of micro, ohm, kelvin, minus and the dot."""
_FACTOR = re.compile(r"([/.*·]?)([^\W\d_]+|[%°]\w*|1)(?:(?:\^|\*\*)?(?:\((-?\d{1,2})\)|(-?\d{1,2})))?")
_GROUP = re.compile(r"/\(([^()/]+)\)")
LONGEST = 200
"""Characters of a unit that is read: files of others have any number of spaces."""
WITHOUT = frozenset({"", "-", "1"})
PLAIN = frozenset({"m", "km", "s", "min", "h", "kg", "t", "kN", "deg", "K", "A", "kW", "bar", "mph"})
"""Symbols that all tools write alike, and none the product of others."""
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


def surely_differ(unit: str, other: str) -> bool:
    """Returns whether two texts are different units beyond doubt: `rpm` and `1/min` may be one, and a file may lack a unit."""
    counted = [powers(each) or {} for each in (unit, other)]
    return counted[0] != counted[1] and all(each and PLAIN.issuperset(each) for each in counted)


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

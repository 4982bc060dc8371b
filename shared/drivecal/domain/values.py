"""Values of parameters: exact decimals with at most nine decimals, and the texts of choices."""

from __future__ import annotations

import hashlib
from decimal import Decimal

BILLION = 1_000_000_000
LARGEST_VALUE = Decimal(1_000_000)
"""Largest magnitude of a bound: its billionths are exact in a float64, which keeps the JSON form of a value exact too."""
TEXTS = 2**61
"""Smallest code of a text: above the billionths of all numbers."""

Value = Decimal | str
"""An exact number, or the text of a choice."""
Setting = float | str
"""A number, or the text of a choice, as simulators, JSON and tables have it."""
Points = list[float] | list[list[float]]
"""Values of a curve at its support points, of a map at [x][y]."""
Argument = Setting | Points
"""A parameter's value as a simulator gets it."""


def decimal(value: float | str | Decimal) -> Decimal:
    """Returns the exact decimal that the user typed: 0.1 means 1/10, not the nearest binary fraction."""
    return value if isinstance(value, Decimal) else Decimal(str(value))


def billionths(value: Decimal) -> int:
    """Returns `value` as an integer number of billionths. Raises ValueError if it is not finite or has more than nine decimals."""
    if not value.is_finite():
        raise ValueError(f"{value} is not a finite number")
    numerator, denominator = value.as_integer_ratio()  # exact; Decimal's own product would round to 28 digits
    scaled, rest = divmod(numerator * BILLION, denominator)
    if rest:
        raise ValueError(f"{value} has more than nine decimals")
    return scaled


def from_billionths(value: int) -> Decimal:
    """Inverts `billionths`, in lowest terms (0.5, not 0.500000000)."""
    return Decimal(value).scaleb(-9).normalize() + Decimal(0)


def text(value: Decimal) -> str:
    """Formats a value without exponent, trailing zeros or negative zero; equal values give equal texts."""
    return billionths_text(billionths(value))


def shown(value: Value) -> str:
    """Formats a number as `text`; returns the text of a choice."""
    return value if isinstance(value, str) else text(value)


def entry(value: Value) -> int | str:
    """Returns what a parameter set stores: billionths, or the text of a choice. Raises ValueError as `billionths`."""
    return value if isinstance(value, str) else billionths(value)


def code(stored: int | str) -> int:
    """Returns an integer that identifies a stored value: its billionths, or for a text its digest, above the billionths of all numbers.

    The code of a text depends on the text alone, not on a list of choices. Codes of texts have no order and no distance.
    """
    if isinstance(stored, int):
        return stored
    return TEXTS + int.from_bytes(hashlib.blake2b(stored.encode(), digest_size=6).digest())


def billionths_text(value: int) -> str:
    """Formats a number of billionths as `text`."""
    whole, rest = divmod(abs(value), BILLION)
    sign, decimals = "-" * (value < 0), f"{rest:09d}".rstrip("0")
    return f"{sign}{whole}.{decimals}" if decimals else f"{sign}{whole}"

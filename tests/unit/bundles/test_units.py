"""Units as texts: spellings of the same unit, and others."""

from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.bundles.units import powers, same

SPELLINGS = (
    ("m/s²", "m/s^2", "m/s2", "m.s-2", "m s-2", "m*s**-2", "m·s⁻²", "m/(s.s)", "m/s/s", " m / s^2 "),
    ("1/m", "m-1", "m^(-1)", "rad/m"),
    ("rad", "1", "-", ""),
    ("km/h", "km.h-1"),
    ("m/s",),
    ("deg",),
    ("°",),
    ("%",),
    ("s, m, m",),
    ("\u00b5m", "\u03bcm"),  # micro, and the Greek letter
    ("k\u2126.s", "k\u03a9\u22c5s", "k\u03a9\u2219s", "k\u03a9\u00b7s"),
    ("\u00b5m, \u00b5m", "\u03bcm, \u03bcm"),
    ("m", "m\u22c5s\u2219s-1"),
    ("1/K", "\u212a\u22121"),
)


@pytest.mark.parametrize("spellings", SPELLINGS)
def test_spellings_of_a_unit_are_the_same(spellings: tuple[str, ...]) -> None:
    assert all(same(unit, other) for unit in spellings for other in spellings)


def test_different_units_are_not_the_same() -> None:
    assert not any(same(row[0], other[0]) for row, other in combinations(SPELLINGS, 2))


@pytest.mark.parametrize("text", ["m//s", "m/", "2m", "s, m, m", "m^", "/", "²"])
def test_what_is_no_product_of_powers_is_only_the_same_as_itself(text: str) -> None:
    assert powers(text) is None
    assert same(text, text)


@given(st.dictionaries(st.sampled_from(["m", "s", "kg", "km", "V"]), st.integers(-9, 9).filter(bool)))
def test_powers_are_read_from_any_order_and_sign(given: dict[str, int]) -> None:
    product = ".".join(f"{symbol}{power}" for symbol, power in reversed(given.items()))
    quotient = "1" + "".join(f"/{symbol}^{-power}" for symbol, power in given.items())
    assert powers(product) == powers(quotient) == given

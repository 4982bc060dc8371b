"""Resources of a simulator and its scenarios: no part of what runs get, nor of their identity."""

from itertools import combinations
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.values import faults_of

from drivecal.bundles.checks import checked
from drivecal.bundles.fingerprints import setup_document
from drivecal.bundles.manifest import Manifest
from drivecal.bundles.units import agree, powers, same


def document(simulator: Any = None, city: Any = None) -> dict[str, Any]:
    return {
        "problem": "mine",
        "parameters": {"x": {"lower": 0, "upper": 1}},
        "simulator": {"kind": "process", "command": ["mysim"]} | ({} if simulator is None else {"resources": simulator}),
        "scenarios": {"city": {"gap": 30} | ({} if city is None else {"resources": city}), "road": {}},
        "measures": {"m": "1"},
        "scores": {"s": {"formula": "m", "direction": "minimise", "range": [0, 1]}},
    }


def test_a_scenario_adds_to_the_resources_of_the_simulator_and_its_data_have_none() -> None:
    manifest = checked(document({"carmaker": 1, "vtd": 1}, {"carmaker": 0, "gpu": 2}))
    assert manifest.resources("city") == {"vtd": 1, "gpu": 2}
    assert manifest.resources("road") == {"carmaker": 1, "vtd": 1}
    assert manifest.scenarios["city"] == {"gap": 30}
    assert Manifest.model_validate(manifest.model_dump(mode="json")) == manifest
    written = checked(document(city={"gpu": 2}) | {"scenario_resources": {"road": {"vtd": 1}}})
    assert [written.resources(scenario) for scenario in ("city", "road")] == [{"gpu": 2}, {"vtd": 1}]


def test_resources_change_no_identity_of_a_run() -> None:
    documents = [
        setup_document(checked(document(simulator, city)), "city", "0" * 64)
        for simulator, city in ((None, None), ({"carmaker": 1}, {"vtd": 2}))
    ]
    assert documents[0] == documents[1]


@pytest.mark.parametrize("counts", [{"carmaker": -1}, {"carmaker": "two"}, {"carmaker": True}, ["carmaker"], {"a b": 1}])
def test_faulty_resources_are_named_where_they_stand(counts: Any) -> None:
    assert [problem.field for problem in faults_of(checked, document(city=counts))] == ["scenarios.city.resources"]
    assert all(problem.field.startswith("simulator") for problem in faults_of(checked, document(counts)))


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


def test_units_of_one_size_agree_and_an_unknown_symbol_leaves_it_open() -> None:
    for unit, others in {"kN*s/m": ("kNs/m", "kN", "foo"), "rpm": ("1/min", "1/s", "turns"), "Nm": ("J", "mNm", "Nmm")}.items():
        assert [agree(unit, other) for other in ("", unit, *others)] == [True, True, True, False, None]


@pytest.mark.parametrize("text", ["m//s", "m/", "2m", "s, m, m", "m^", "/", "²"])
def test_what_is_no_product_of_powers_is_only_the_same_as_itself(text: str) -> None:
    assert powers(text) is None
    assert same(text, text)


@given(st.dictionaries(st.sampled_from(["m", "s", "kg", "km", "V"]), st.integers(-9, 9).filter(bool)))
def test_powers_are_read_from_any_order_and_sign(given: dict[str, int]) -> None:
    product = ".".join(f"{symbol}{power}" for symbol, power in reversed(given.items()))
    quotient = "1" + "".join(f"/{symbol}^{-power}" for symbol, power in given.items())
    assert powers(product) == powers(quotient) == given

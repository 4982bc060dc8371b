"""Setups and their fingerprints."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.domain.setups import Setup, canonical_json

DOCUMENT: dict[str, Any] = {
    "simulator": {"kind": "highway", "step": 0.1},
    "adapter": "1",
    "scenario": "S1",
    "data": {"seed": 1},
    "files": "00ff",
    "varied": {"mass": 2060.0, "distance_front": 1.66},
    "sumo": "libsumo 1.28.0",
}
SETUP = Setup("S1", DOCUMENT)

documents = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda children: st.lists(children) | st.dictionaries(st.text(), children),
    max_leaves=15,
)


@pytest.mark.parametrize(("part", "value"), [("data", {"seed": 2}), ("varied", {"mass": 2060.0000000000005}), ("sumo", "2")])
def test_any_change_of_a_setup_changes_its_fingerprint(part: str, value: object) -> None:
    assert Setup("S1", {**DOCUMENT, part: value}).fingerprint != SETUP.fingerprint


def test_a_setup_names_its_simulator_and_varied_values() -> None:
    assert SETUP.simulator == "highway (adapter 1, libsumo 1.28.0)"
    assert SETUP.varied["mass"] == 2060.0
    assert Setup("S1", {**DOCUMENT, "varied": {}}).varied == {}


def test_fingerprints_are_known() -> None:
    """Every stored result is found by its setup's fingerprint: the same setup must always have the same."""
    assert SETUP.fingerprint == "4874f38da9109eee3df9e3c9ef95e2c9"


@given(documents)
def test_canonical_json_is_json_and_stable(document: object) -> None:
    once = canonical_json(document)
    assert json.loads(once) == document
    assert canonical_json(json.loads(once)) == once


@given(st.dictionaries(st.text(), st.integers()))
def test_canonical_json_does_not_depend_on_the_order_of_keys(document: dict[str, int]) -> None:
    assert canonical_json(dict(reversed(document.items()))) == canonical_json(document)


def test_nan_has_no_canonical_form() -> None:
    with pytest.raises(ValueError, match="JSON"):
        canonical_json({"m": float("nan")})

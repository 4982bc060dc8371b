"""Setups and their fingerprints."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.domain.setups import DrivenSetup, canonical_json

SETUP = DrivenSetup(
    scenario="S1",
    scenario_digest="00ff",
    driving_function="frenet",
    driving_function_version="1",
    vehicle="single_track",
    vehicle_version="1",
    vehicle_parameters={"m": 2060.0, "l_f": 1.66},
    simulator="libsumo 1.28.0",
    step_seconds=0.1,
    seed=1,
)

CHANGES: dict[str, Any] = {
    "scenario": "S2",
    "scenario_digest": "00fe",
    "driving_function": "other",
    "driving_function_version": "1.1",
    "vehicle": "hybrid",
    "vehicle_version": "2",
    "vehicle_parameters": {"m": 2060.0000000000005, "l_f": 1.66},
    "simulator": "libsumo 1.28.1",
    "step_seconds": 0.05,
    "seed": 2,
}

documents = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda children: st.lists(children) | st.dictionaries(st.text(), children),
    max_leaves=15,
)


@pytest.mark.parametrize("field", [field.name for field in fields(DrivenSetup)])
def test_any_change_of_a_setup_changes_its_fingerprint(field: str) -> None:
    changed = replace(SETUP, **{field: CHANGES[field]})
    assert changed.fingerprint != SETUP.fingerprint


def test_the_order_of_vehicle_parameters_does_not_matter() -> None:
    other = replace(SETUP, vehicle_parameters={"l_f": 1.66, "m": 2060.0})
    assert other.fingerprint == SETUP.fingerprint


def test_a_setup_survives_the_way_through_its_document() -> None:
    other = DrivenSetup.from_document(json.loads(canonical_json(SETUP.document)))
    assert other == SETUP
    assert other.fingerprint == SETUP.fingerprint


def test_fingerprints_are_known() -> None:
    """Every stored result is found by its setup's fingerprint: the same setup must always have the same."""
    assert SETUP.fingerprint == "848de4cf90ae1d389ae8eb3fee45ee81"


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

"""`NAME=VALUE` on a command line: numbers, and texts for choices."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.values import faults_of

from drivecal.contracts.assignments import assignments, settings, value_text
from drivecal.domain.errors import InvalidInputError

CHOICE = st.text(st.characters(exclude_categories=["Cs", "Cc", "Z"]), min_size=1, max_size=12)


def test_what_is_no_number_is_a_text() -> None:
    known = {"P1": 0.5, "mode": "eco", "name": "a=b", "P2": -3.0}
    assert settings(["P1=0.5", "mode=eco", "name=a=b", "P2 = -3"], "parameters") == known


@given(CHOICE | st.floats(-1e6, 1e6))
def test_a_written_value_is_read_as_it_was(value: float | str) -> None:
    read = settings([f"x={value_text(value, None)}"], "parameters")["x"]
    if isinstance(value, float) or isinstance(read, str):
        assert read == value


@pytest.mark.parametrize("parts", [["mode"], ["=eco"], ["mode="], ["mode=eco", "mode=sport"], ["P1=1", "P1=2"]])
def test_what_is_no_assignment_is_refused(parts: list[str]) -> None:
    assert all(problem.field.startswith("parameters") for problem in faults_of(settings, parts, "parameters"))


def test_weights_stay_numbers() -> None:
    with pytest.raises(InvalidInputError):
        assignments(["S1=eco"], "weights")


def test_a_value_has_the_digits_that_give_it_again() -> None:
    texts: dict[float | str, str] = {8.2: "8.2", 28.0: "28", 1e-7: "1e-07", 0.1 + 0.2: "0.30000000000000004", "eco": "eco"}
    assert {value: value_text(value, None) for value in texts} == texts

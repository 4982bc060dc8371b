"""Continuous parameters, integers and choices: values, keys and bounds."""

import json
from decimal import Decimal
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.values import faults_of, faulty_fields
from tests.unit.domain.test_parameters import grids

from drivecal.domain.parameters import Parameter, ParameterSet, ParameterSpace
from drivecal.domain.values import BILLION, TEXTS, code, from_billionths

LARGEST = 1_000_000 * BILLION
TEXT = st.text(alphabet=st.characters(exclude_categories=["Cs"]), min_size=1, max_size=20)
MODES = Parameter.choice("mode", ["eco", "sport", 'Küche "x";P=1'])


@st.composite
def continuous(draw: st.DrawFn) -> Parameter:
    lower = draw(st.integers(-LARGEST, LARGEST - 1))
    upper = draw(st.integers(lower + 1, LARGEST))
    return Parameter.from_step("P", from_billionths(lower), from_billionths(upper), draw(st.sampled_from([None, Decimal(0)])))


@st.composite
def integers(draw: st.DrawFn) -> Parameter:
    lower = draw(st.integers(-1_000_000, 999_999))
    return Parameter.integer("P", Decimal(lower), Decimal(draw(st.integers(lower + 1, 1_000_000))))


def lattices() -> st.SearchStrategy[Parameter]:
    return st.sampled_from([1, 7, 11, 19]).map(
        lambda bits: Parameter.from_bits("P", Decimal(-1000000), Decimal("999999.9"), bits)
    )


@given(continuous() | integers() | grids() | lattices(), st.data())
def test_values_indices_and_bounds_agree_without_a_table(parameter: Parameter, data: st.DataObject) -> None:
    indices = data.draw(st.lists(st.integers(0, parameter.n_values - 1), min_size=1, max_size=5))
    values = [parameter.billionths(index) for index in indices]
    assert parameter.billionths_at(np.array(indices)).tolist() == values
    for index, value in zip(indices, values, strict=True):
        assert parameter.index(parameter.value(index)) == index
        assert parameter.first_from(value) == index
        assert parameter.first_from(value + 1) == index + 1
    assert parameter.value(parameter.n_values - 1) == parameter.upper


@given(continuous())
def test_a_continuous_parameter_has_all_decimals_of_nine_places(parameter: Parameter) -> None:
    assert parameter.kind == "continuous"
    assert parameter.n_values == (parameter.upper - parameter.lower) * BILLION + 1


@pytest.mark.parametrize(("lower", "upper", "field"), [("0.5", "2", "P.lower"), ("0", "2.5", "P.upper"), ("2", "2", "P.upper")])
def test_an_integer_has_whole_bounds(lower: str, upper: str, field: str) -> None:
    assert [problem.field for problem in faults_of(Parameter.integer, "P", Decimal(lower), Decimal(upper))] == [field]


@pytest.mark.parametrize("choices", [[], ["eco"], ["eco", "eco"]])
def test_a_choice_needs_two_different_texts(choices: list[str]) -> None:
    assert [problem.field for problem in faults_of(Parameter.choice, "mode", choices)] == ["mode.choices"]


def test_a_choice_is_its_text_and_nothing_else() -> None:
    assert [MODES.named(index) for index in range(3)] == list(MODES.choices)
    assert [MODES.index(text) for text in MODES.choices] == [0, 1, 2]
    for wrong in ("fast", Decimal(1), Decimal("2.5e-16"), Decimal("Infinity")):
        (problem,) = faults_of(MODES.index, wrong, "baseline.mode")
        assert problem.field == "baseline.mode"
        assert "eco, sport" in problem.remedy


def test_a_number_is_no_text() -> None:
    assert faulty_fields(Parameter.from_step("P", Decimal(0), Decimal(1), None).index, "0.5") == ["P"]


@given(st.dictionaries(TEXT, st.integers(-LARGEST, LARGEST).map(from_billionths) | TEXT, min_size=1, max_size=5))
def test_sets_with_texts_survive_json_and_keep_their_key(values: dict[str, Decimal | str]) -> None:
    made = ParameterSet.of(values)
    assert ParameterSet.from_json(made.to_json()) == made
    assert made.values == values
    assert json.loads(made.to_json()) == made.floats
    for order in list(permutations(values))[:6]:
        assert ParameterSet.of({name: values[name] for name in order}).key == made.key


@given(TEXT, TEXT, st.integers(-LARGEST, LARGEST))
def test_texts_have_keys_and_codes_of_their_own(first: str, second: str, number: int) -> None:
    keys = {ParameterSet.of({"P": value}).key for value in (first, second, from_billionths(number))}
    assert len(keys) == len({first, second, number})
    assert code(first) >= TEXTS > code(number) == number
    assert (code(first) == code(second)) == (first == second)


def test_a_text_cannot_pose_as_further_parameters() -> None:
    assert ParameterSet.of({"a": "1;b=2"}).key != ParameterSet.of({"a": Decimal("1e-9"), "b": Decimal("2e-9")}).key


@given(st.permutations(["eco", "sport", "winter", "tow"]), st.integers(2, 4))
def test_keys_do_not_depend_on_the_order_or_number_of_choices(choices: list[str], count: int) -> None:
    space = ParameterSpace((Parameter.choice("mode", choices[:count]), Parameter.from_step("P", Decimal(0), Decimal(1), None)))
    for index, text in enumerate(choices[:count]):
        parameters = space.parameter_set([index, 25])
        assert parameters == ParameterSet.of({"mode": text, "P": Decimal("0.000000025")})
        assert space.indices(parameters.values).tolist() == [index, 25]


def test_a_fixed_choice_keeps_its_text() -> None:
    numbers = Parameter.integer("n", Decimal(1), Decimal(9))
    space = ParameterSpace((MODES, numbers), {"mode": "sport"})
    assert space.parameter_set([3]).floats == {"mode": "sport", "n": 4.0}
    assert space.kinds == ("integer",)
    assert space.indices({"mode": "sport", "n": Decimal(4)}).tolist() == [3]
    assert faulty_fields(space.indices, {"mode": "eco", "n": Decimal(4)}, "baseline") == ["baseline.mode"]

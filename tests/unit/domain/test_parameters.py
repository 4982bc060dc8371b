"""Parameters on integer grids, parameter sets and spaces."""

from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.values import faults_of

from drivecal.domain.errors import InvalidInputError
from drivecal.domain.parameters import Parameter, ParameterSet, ParameterSpace
from drivecal.domain.values import BILLION, billionths, decimal, from_billionths, text

largest = 1_000_000 * BILLION
amounts = st.integers(-largest, largest)
names = st.text(alphabet="ABCPQRabc_0123456789", min_size=1, max_size=6)


@st.composite
def grids(draw: st.DrawFn) -> Parameter:
    """A grid made from a step, in billionths, anywhere within the allowed bounds."""
    step = draw(st.sampled_from([1, 10**7, 10**8, 5 * 10**8, 10**9]) | st.integers(1, 10**10))
    n_values = draw(st.integers(2, 3000))
    lower = draw(st.integers(-largest, largest - step * (n_values - 1)))
    upper = lower + step * (n_values - 1)
    return Parameter.from_step("P", from_billionths(lower), from_billionths(upper), from_billionths(step))


@st.composite
def lattices(draw: st.DrawFn) -> Parameter:
    """A grid made from bits, wide enough for distinct values."""
    bits = draw(st.integers(1, 11))
    span = draw(st.integers(2**bits - 1, 2**bits + 5) | st.integers(2**bits, largest))
    lower = draw(st.integers(-largest, largest - span))
    return Parameter.from_bits("P", from_billionths(lower), from_billionths(lower + span), bits)


@given(amounts)
def test_a_value_survives_the_way_to_billionths_text_and_back(value: int) -> None:
    exact = from_billionths(value)
    assert billionths(exact) == value
    assert billionths(Decimal(text(exact))) == value
    assert text(exact) == format(exact, "f")


@given(amounts)
def test_a_float_with_nine_decimals_is_the_decimal_that_was_typed(value: int) -> None:
    assert billionths(decimal(float(from_billionths(value)))) == value


@pytest.mark.parametrize(
    ("value", "written"),
    [("0.50", "0.5"), ("-0", "0"), ("1E+3", "1000"), ("1e-9", "0.000000001"), ("100", "100"), ("-15.0", "-15")],
)
def test_a_value_is_written_in_one_way_only(value: str, written: str) -> None:
    assert text(Decimal(value)) == written


@pytest.mark.parametrize("value", ["1e-10", "0.1234567891", "0.1000000000000000000000000000000000000001"])
def test_more_than_nine_decimals_are_refused_however_many_they_are(value: str) -> None:
    with pytest.raises(ValueError, match="nine decimals"):
        billionths(Decimal(value))


@pytest.mark.parametrize("value", ["NaN", "Infinity", "-Infinity"])
def test_what_is_not_finite_has_no_billionths(value: str) -> None:
    with pytest.raises(ValueError, match="finite"):
        billionths(Decimal(value))


@given(lattices())
def test_values_of_a_lattice_are_distinct_and_evenly_spaced_to_the_ninth_decimal(parameter: Parameter) -> None:
    distances = np.diff(parameter.billionths_at(np.arange(parameter.n_values)))
    assert distances.min() >= 1
    assert distances.max() - distances.min() <= 1


def test_the_lattice_of_six_bits_holds_the_63rds_of_the_paper() -> None:
    parameter = Parameter.from_bits("P1", Decimal(0), Decimal(1), 6)
    assert parameter.n_values == 64
    assert [str(parameter.value(index)) for index in (0, 11, 26, 63)] == ["0", "0.174603175", "0.412698413", "1"]


@given(grids(), st.data())
def test_a_value_between_two_of_the_grid_is_refused_with_both_of_them(parameter: Parameter, data: st.DataObject) -> None:
    index = data.draw(st.integers(0, parameter.n_values - 2))
    low, high = parameter.billionths(index), parameter.billionths(index + 1)
    if high - low < 2:
        return
    between = from_billionths(data.draw(st.integers(low + 1, high - 1)))
    (problem,) = faults_of(parameter.index, between, "baseline.P")
    assert problem.field == "baseline.P"
    assert str(between) in problem.message
    assert f"{text(parameter.value(index))} or {text(parameter.value(index + 1))}" in problem.remedy


@pytest.mark.parametrize("value", ["-0.1", "2.1", "NaN", "Infinity"])
def test_a_value_outside_the_range_is_refused_with_the_range(value: str) -> None:
    parameter = Parameter.from_step("P2", Decimal(0), Decimal(2), Decimal("0.1"))
    with pytest.raises(InvalidInputError, match="from 0 to 2") as refused:
        parameter.index(Decimal(value))
    assert [problem.field for problem in refused.value.problems] == ["P2"]


@pytest.mark.parametrize("index", [-1, 21])
def test_an_index_off_the_grid_is_refused(index: int) -> None:
    parameter = Parameter.from_step("P2", Decimal(0), Decimal(2), Decimal("0.1"))
    with pytest.raises(IndexError, match=f"P2.* 0 to 20.* {index}"):
        parameter.value(index)


@pytest.mark.parametrize(
    ("lower", "upper", "step", "field", "named"),
    [
        ("0", "1", "-0.1", "P.step", "-0.1"),
        ("1", "1", "0.1", "P.upper", "`fixed`"),
        ("2", "1", "0.1", "P.upper", "upper 1 .* lower 2; swap"),
        ("0", "1", "0.3", "P.step", "step 0.3.* 0.9 or 1.2"),
        ("0", "1", "3", "P.step", "step 3.* at most 1$"),
        ("0", "100", "0.00001", "P.step", "10000001.* 1,000,000"),
        ("NaN", "1", "0.1", "P.lower", "NaN"),
        ("0", "Infinity", "0.1", "P.upper", "Infinity.* ±1000000"),
        ("0", "1e30", "0.1", "P.upper", "30.* ±1000000"),
        ("0", "1", "1e-10", "P.step", "nine decimals"),
        ("0.00000000001", "1", "0.1", "P.lower", "nine decimals"),
    ],
)  # fmt: skip
def test_a_bad_grid_is_refused_by_field_with_a_remedy(lower: str, upper: str, step: str, field: str, named: str) -> None:
    with pytest.raises(InvalidInputError, match=named) as refused:
        Parameter.from_step("P", Decimal(lower), Decimal(upper), Decimal(step))
    assert [(problem.field, bool(problem.remedy)) for problem in refused.value.problems] == [(field, True)]


@pytest.mark.parametrize(
    ("lower", "upper", "bits", "field", "named"),
    [
        ("0", "1", 0, "P.bits", "1 to 19"),
        ("0", "1", 20, "P.bits", "20 .* 1 to 19"),
        ("0", "1e-9", 2, "P.bits", "ninth decimal"),
        ("1", "0", 4, "P.upper", "empty"),
    ],
)
def test_a_bad_lattice_is_refused_by_field(lower: str, upper: str, bits: int, field: str, named: str) -> None:
    with pytest.raises(InvalidInputError, match=named) as refused:
        Parameter.from_bits("P", Decimal(lower), Decimal(upper), bits)
    assert [(problem.field, bool(problem.remedy)) for problem in refused.value.problems] == [(field, True)]


sets = st.dictionaries(names, amounts, min_size=1, max_size=11).map(
    lambda values: ParameterSet(tuple(values), tuple(values.values()))
)


@given(sets, sets)
def test_different_sets_have_different_keys(one: ParameterSet, other: ParameterSet) -> None:
    same = dict(zip(one.names, one.billionths, strict=True)) == dict(zip(other.names, other.billionths, strict=True))
    assert (one.key == other.key) == same


def test_keys_are_known() -> None:
    """Every stored result is found by such a key: it must never change."""
    one = ParameterSet.of({"P1": Decimal("0.5"), "P2": Decimal(-3), "P10": Decimal("0.000000001")})
    assert one.key.hex() == "539aa7abdce0f3ca8609303f684f7275"


A = Parameter.from_step("A", Decimal(0), Decimal(1), Decimal("0.1"))
B = Parameter.from_step("B", Decimal(-5), Decimal(5), Decimal(1))
C = Parameter.from_step("C", Decimal(0), Decimal(200), Decimal(1))


def test_fixed_parameters_are_held_and_not_searched() -> None:
    space = ParameterSpace((A, B, C), {"B": Decimal(2)})
    assert [parameter.name for parameter in space.searched] == ["A", "C"]
    assert space.n_values.tolist() == [11, 201]
    assert space.parameter_set([3, 40]).values == {"A": Decimal("0.3"), "B": Decimal(2), "C": Decimal(40)}


@given(st.lists(st.tuples(st.integers(0, 10), st.integers(0, 10), st.integers(0, 200)), min_size=1, max_size=20))
def test_populations_and_parameter_sets_are_inverse(rows: list[tuple[int, int, int]]) -> None:
    space = ParameterSpace((A, B, C))
    population = np.array(rows)
    back = np.array([space.indices(parameter_set.values) for parameter_set in space.parameter_sets(population)])
    assert np.array_equal(back, population)


@pytest.mark.parametrize("row", [[-1, 0, 0], [0, 11, 0], [0, 0, 201]])
def test_an_individual_off_the_grid_is_refused(row: list[int]) -> None:
    with pytest.raises(IndexError, match="individual 1"):
        ParameterSpace((A, B, C)).parameter_sets(np.array([[0, 0, 0], row]))


def test_everything_wrong_with_values_is_said_at_once() -> None:
    space = ParameterSpace((A, B, C), {"C": Decimal(5)})
    refused = faults_of(space.indices, {"A": Decimal("0.15"), "D": Decimal(1), "C": Decimal(6)}, "baseline")
    assert {problem.field for problem in refused} == {f"baseline.{name}" for name in "ABCD"}
    remedies = {problem.field: problem.remedy for problem in refused}
    assert "A, B, C" in remedies["baseline.D"]
    assert "0.1 or 0.2" in remedies["baseline.A"]
    assert "5" in remedies["baseline.C"]


def test_a_fixed_parameter_may_be_left_out_or_given_with_its_value() -> None:
    space = ParameterSpace((A, C), {"C": Decimal(5)})
    assert space.indices({"A": Decimal("0.4")}).tolist() == [4]
    assert space.indices({"A": Decimal("0.4"), "C": Decimal("5.0")}).tolist() == [4]

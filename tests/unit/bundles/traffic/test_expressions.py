"""Expressions of OpenSCENARIO: every operator and function of the standard, their precedence, and what is refused."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.bundles.traffic.expressions import FUNCTIONS, ExpressionError, evaluated

VALUES: dict[str, float | bool] = {"a": 7.0, "b": -2.5, "yes": True, "no": False}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("-pi/2", -1.5707963267948966),
        ("2 * PI", 6.283185307179586),
        ("e", 2.718281828459045),
        ("1 + 2 * 3 - 4 / 8", 6.5),
        ("-(1 + 2) * +3", -9.0),
        ("a % 4 + a % -4", 6.0),
        ("-a % 4", -3.0),
        ("7.5 % 2", 1.5),
        ("round(2.5) + round(-2.5) + round(2.4)", 2.0),
        ("floor(b) + ceil(b)", -5.0),
        ("pow(2, 3) * sqrt(16)", 32.0),
        ("sign(b) + sign(a) * 10 + sign(0)", 9.0),
        ("abs(b) + max(a, b) + min(a, b)", 7.0),
        ("sin(pi / 2) + cos(0) + tan(0)", 2.0),
        ("asin(1) + acos(1) + atan(0)", 1.5707963267948966),
        ("2.1E-1 + .5 + 3.", 3.71),
        ("yes and not no", True),
        ("no or not yes", False),
        ("not a > 3 or b <= -2.5", True),
        ("(a == 7) != no", True),
    ],
)
def test_an_expression_has_the_value_of_the_standard(text: str, value: float | bool) -> None:
    result = evaluated(text, VALUES)
    assert isinstance(result, bool) == isinstance(value, bool)
    assert result == pytest.approx(value, abs=1e-12)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("rounded(1)", "round"),
        ("c + 1", "c"),
        ("pow(2)", "2"),
        ("sqrt", "sqrt"),
        ("1 / 0", "zero"),
        ("sqrt(-1)", "domain"),
        ("pow(10, 400)", "range"),
        ("1e308 * 10", "finite"),
        ("yes + 1", "number"),
        ("a and yes", "true"),
        ("2 ** 3", "*"),
        ("7 // 2", "/"),
        ("a.real", "."),
        ("'text'", "'"),
        ("[1]", "["),
        ("(lambda: 1)()", ":"),
        ("1 < 2 < 3", "arithmetic"),
        ("1 +", "read"),
        ("", "read"),
        ("-" * 150 + "1", "levels"),
        ("1" * 2001, "2000"),
    ],
)
def test_what_is_no_expression_is_refused_with_its_cause(text: str, named: str) -> None:
    with pytest.raises(ExpressionError) as error:
        evaluated(text, VALUES)
    assert named in f"{error.value.message} {error.value.remedy}"


@given(
    st.lists(
        st.sampled_from(
            [*FUNCTIONS, *VALUES, "pi", "(", ")", ",", "-", "+", "*", "/", "%", " ", "not", "and", "or", "<", "2", "1e9"]
        )
    )
)
def test_any_row_of_words_has_a_value_or_is_refused(words: list[str]) -> None:
    try:
        result = evaluated(" ".join(words), VALUES)
    except ExpressionError:
        return
    assert result == result

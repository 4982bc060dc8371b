import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.values import faults_of

from drivecal.domain.errors import InvalidInputError
from drivecal.storage.engine.records import decode_cursor, encode_cursor

NUMBERS = st.integers(0, 2**31 - 1)
NAMES = st.from_regex(r"[A-Za-z][A-Za-z0-9_.-]{0,63}", fullmatch=True)


@given(NUMBERS, NAMES)
def test_a_cursor_gives_back_the_position_it_was_made_of(number: int, name: str) -> None:
    cursor = encode_cursor(number, name)
    assert decode_cursor(cursor, int, str) == (number, name)
    assert cursor.isascii()
    assert not set(cursor) & set("+/=&?# ")


@given(st.text())
def test_any_other_text_is_refused_by_name(text: str) -> None:
    assert [problem.field for problem in faults_of(decode_cursor, text, int, int, str)] == ["cursor"]


@pytest.mark.parametrize(
    "cursor",
    [
        encode_cursor(1),
        encode_cursor(1, 2, 3),
        encode_cursor("1", 2),
        encode_cursor(2**31, 2),
        encode_cursor(-1, 2),
        encode_cursor(1, -(10**40)),
        "W3RydWUsMl0",  # [true,2]: no number, though Python would let it pass for one
        "WzEuMCwyXQ",  # [1.0,2]
        "W05hTiwyXQ",  # [NaN,2]
        "eyJhIjoxfQ",  # {"a":1}
        "W1tbW1tb" * 10_000,
    ],
)
def test_what_is_no_position_of_this_list_is_refused(cursor: str) -> None:
    with pytest.raises(InvalidInputError, match="`next_cursor`"):
        decode_cursor(cursor, int, int)


@pytest.mark.parametrize("name", ["\0", "\ud800", "\n"])
def test_text_that_a_database_cannot_compare_is_refused(name: str) -> None:
    with pytest.raises(InvalidInputError):
        decode_cursor(encode_cursor(name), str)

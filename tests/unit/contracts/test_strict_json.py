"""Reading JSON from outside."""

import json
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.contracts.strict_json import DEEPEST, loads, shown
from drivecal.domain.errors import InvalidInputError

plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**30), 10**30) | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda children: st.lists(children) | st.dictionaries(st.text(), children),
    max_leaves=20,
)


@given(plain)
def test_what_is_plain_json_is_read_as_python_reads_it(document: object) -> None:
    content = json.dumps(document).encode()
    assert loads(content) == json.loads(content)


@given(st.binary(max_size=200))
def test_any_bytes_are_either_read_or_refused(content: bytes) -> None:
    with suppress(InvalidInputError):
        loads(content)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b'{"weights": {"S1": NaN}}', r"^weights.S1: NaN is not a JSON number"),
        (b"[Infinity]", r"^\[0\]: .*finite"),
        (b'{"a": [0, -Infinity]}', r"^a\[1\]: .*finite"),
        (b'{"a": 1e999}', "^a: .*finite"),
        (b'{"a": ' + b"9" * 5000 + b"}", "^a: .*finite"),
        (b'{"a": 1, "a": 2}', "a: the key"),
        (b'{"a": {"b": 1, "b": 2}}', "b: the key"),
        (rb'{"name": "\ud800"}', "^name: .*surrogate"),
        (rb'{"\udfff": 1}', "surrogate"),
        (b'"\xff"', "byte 1 "),
        (b"", "empty"),
        (b" \n", "empty"),
        (b'{"a": \n  }', "line 2, column 3"),
        (b"[" * 100_000, "32 levels"),
        (b"[" * (DEEPEST + 1) + b"]" * (DEEPEST + 1), "32 levels"),
        (b'{"a":' * 40 + b"1" + b"}" * 40, "32 levels"),
        (b"[" + b"0," * 300_000 + b"0]", "300,001 values.*100,000"),
        (json.dumps({"a": {str(key): 0 for key in range(3000)}}).encode(), "^a: .*3,000 entries.*2,000"),
    ],
)
def test_surprises_are_refused_with_what_is_wrong(content: bytes, said: str) -> None:
    with pytest.raises(InvalidInputError, match=said):
        loads(content)


def test_the_deepest_nesting_allowed_is_read() -> None:
    assert loads(b"[" * DEEPEST + b"]" * DEEPEST)


def test_a_byte_order_mark_and_whole_surrogate_pairs_are_read() -> None:
    assert loads(b"\xef\xbb\xbf" + rb'"\ud83d\ude97"') == "\N{AUTOMOBILE}"


@given(st.text() | st.floats() | st.integers() | st.none() | st.booleans() | st.lists(st.integers()))
def test_a_value_in_a_message_is_short_and_on_one_line(value: object) -> None:
    text = shown(value)
    assert len(text) <= 60
    assert text.isprintable()

"""Answers hold names and messages of other people, which end on a terminal."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.scripted import problem, server

from drivecal.client.transport import harmless
from drivecal.domain.errors import ConflictError

STEERING = ["\x1b]0;owned\x07", "\x9b31m", "\u202egnp.exe", "\u2066", "\x7f", "\r", "\x00", "\u200f"]


@pytest.mark.parametrize("text", STEERING)
@pytest.mark.parametrize("ascii_only", [True, False])
def test_what_steers_a_terminal_is_replaced_escaped_or_not(text: str, ascii_only: bool) -> None:
    content = json.dumps({"name": f"a{text}b"}, ensure_ascii=ascii_only).encode()
    shown = json.loads(harmless(content))["name"]
    assert shown != f"a{text}b" or text == "\r"
    assert not any(character in shown for character in "\x00\x1b\x07\x7f\x9b\u202e\u2066\u200f")


def test_a_refusal_of_the_server_is_harmless_too() -> None:
    with server(problem(409, "\x1b[2Jgone")) as (client, _), pytest.raises(ConflictError) as caught:
        client.submit({})
    assert str(caught.value) == "\ufffd[2Jgone"


@given(
    st.dictionaries(st.text(), st.text(st.characters(exclude_categories=["Cc", "Cf", "Cs"])) | st.just("back\\u001bslash\n"))
)
def test_every_other_text_stays_as_it_is(texts: dict[str, str]) -> None:
    plain = {f"k{number}": text for number, text in enumerate(texts.values())}
    for ascii_only in (True, False):
        assert json.loads(harmless(json.dumps(plain, ensure_ascii=ascii_only).encode())) == plain


@given(st.text())
def test_a_json_text_stays_one(text: str) -> None:
    assert isinstance(json.loads(harmless(json.dumps(text).encode())), str)

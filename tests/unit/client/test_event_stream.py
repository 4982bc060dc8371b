"""Event streams, as the standard's own examples and as ours."""

import json
from itertools import pairwise

import pytest
from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event
from hypothesis import given
from hypothesis import strategies as st

from drivecal.client.following import EventParser

EXAMPLES: list[tuple[bytes, list[tuple[str, str, str | None]]]] = [
    (b"data: YHOO\ndata: +2\ndata: 10\n\n", [("message", "YHOO\n+2\n10", None)]),
    (
        b": test stream\n\ndata: first event\nid: 1\n\ndata:second event\nid\n\ndata:  third event\n\n",
        [("message", "first event", "1"), ("message", "second event", ""), ("message", " third event", None)],
    ),
    (b"data\n\ndata\ndata\n\ndata:", [("message", "", None), ("message", "\n", None)]),
    (b"data:test\n\ndata: test\n\n", [("message", "test", None), ("message", "test", None)]),
    (b"event: add\r\ndata: 7\r\n\r\nevent: remove\rdata: 8\r\rx", [("add", "7", None), ("remove", "8", None)]),
    (b"\xef\xbb\xbfdata: after a mark\n\n", [("message", "after a mark", None)]),
    (b"event: nothing\nid: 5\n\ndata: x\n\n", [("message", "x", None)]),
    (b"id: a\0b\nunknown: y\n: comment\ndata: x\n\n", [("message", "x", None)]),
    ("data: ä\u2028ö\n\n".encode(), [("message", "ä\u2028ö", None)]),
    (b"data: \xff\n\n", [("message", "\ufffd", None)]),
]


def parsed(*chunks: bytes) -> list[tuple[str, str, str | None]]:
    parser = EventParser()
    return [(one.event, one.data, one.id) for chunk in chunks for one in parser.feed(chunk)]


@pytest.mark.parametrize(("stream", "expected"), EXAMPLES)
def test_streams_are_read_as_the_standard_says(stream: bytes, expected: list[tuple[str, str, str | None]]) -> None:
    assert parsed(stream) == expected
    assert parsed(*(stream[index : index + 1] for index in range(len(stream)))) == expected, "byte by byte"


@given(st.lists(st.tuples(st.text(max_size=20), st.integers(0, 2**63 - 1)), max_size=5), st.lists(st.integers(0, 200)))
def test_what_the_server_writes_comes_out_however_it_is_cut(events: list[tuple[str, int]], cuts: list[int]) -> None:
    written = b"".join(
        KEEPALIVE_COMMENT + format_sse_event(event="note", id=str(number), data_str=json.dumps({"text": text}))
        for text, number in events
    )
    places = [0, *sorted(min(cut, len(written)) for cut in cuts), len(written)]
    pieces = [written[begin:end] for begin, end in pairwise(places)]
    expected = [("note", json.dumps({"text": text}), str(number)) for text, number in events]
    assert parsed(*pieces) == expected

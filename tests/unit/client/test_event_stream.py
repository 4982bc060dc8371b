"""Event streams, as the server writes them."""

import json
from itertools import pairwise

from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event
from hypothesis import given
from hypothesis import strategies as st

from drivecal.client.following import EventParser


def parsed(*chunks: bytes) -> list[tuple[str, str, str | None]]:
    parser = EventParser()
    return [(item.event, item.data, item.id) for chunk in chunks for item in parser.feed(chunk)]


def test_what_is_incomplete_or_no_text_ends_no_stream() -> None:
    assert parsed(b"data: \xff\n\nid: 1\n\n: nothing\n\ndata: begun\n") == [("message", "\ufffd", None)]


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

"""Events and states of a campaign that is watched, over streams that break off."""

import json
import time
import weakref
from collections.abc import Iterator
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import pytest
from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event
from hypothesis import given
from hypothesis import strategies as st
from tests.support.scripted import Answer, campaign, problem, server

from drivecal.client import Client, following, transport
from drivecal.client.following import EventParser
from drivecal.contracts.campaign import Campaign
from drivecal.domain.errors import UnavailableError


def stream(*events: tuple[str, str, dict[str, Any]], broken: bool = False) -> Answer:
    """An event stream that ends, or breaks off; each event is (id, kind, document)."""
    lines = [
        f"event: {kind}\n" + (f"id: {number}\n" if number else "") + f"data: {json.dumps(document)}\n\n"
        for number, kind, document in events
    ]
    body = "".join(lines).encode()
    if broken:
        return 200, {"Transfer-Encoding": "chunked"}, f"{len(body):x}\r\n".encode() + body + b"\r\nzz"
    return 200, {"Content-Type": "text/event-stream"}, body


def event(number: str, kind: str, **data: Any) -> tuple[str, str, dict[str, Any]]:
    return number, kind, {"kind": kind, "campaign": "0" * 32, "at": "2026-01-01T00:00:00Z", "data": data}


def do_not_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(sleep=lambda _: None, monotonic=time.monotonic)  # of these modules alone: other threads sleep on
    for module in (following, transport):
        monkeypatch.setattr(module, "time", clock)


def test_watching_resumes_its_stream_where_it_broke_off(monkeypatch: pytest.MonkeyPatch) -> None:
    do_not_wait(monkeypatch)
    progress = ("", "progress", {"state": "running", "stages": {"calibration": {"requested": 5}}})
    answers = [
        campaign("queued", ETag='"a"'),
        stream(event("7", "queued"), event("9", "running"), progress, broken=True),
        (304, {"ETag": '"a"'}, b""),
        stream(event("", "degraded", reason="x"), event("12", "succeeded"), ("", "progress", {"state": "succeeded"})),
        campaign("succeeded", ETag='"b"'),
    ]
    told: list[tuple[int | None, str]] = []
    with server(*answers) as (client, script):
        seen = [
            (answer.state, answer.cells.requested)
            for answer in client.watch("0" * 32, told=lambda event: told.append((event.id, event.kind)))
        ]
    assert seen == [("queued", 0), ("running", 5), ("succeeded", 0), ("succeeded", 0)]
    assert told == [(7, "queued"), (9, "running"), (None, "degraded"), (12, "succeeded")]
    streams = [headers.get("last-event-id") for _, path, headers, _ in script.requests if path.endswith("/events")]
    assert streams == [None, "9"]


@pytest.mark.parametrize("refusal", [problem(429), problem(404), (404, {}, b"<html>"), problem(405)])
def test_watching_asks_only_for_what_is_new_where_there_is_no_stream(monkeypatch: pytest.MonkeyPatch, refusal: Answer) -> None:
    do_not_wait(monkeypatch)
    unchanged: Answer = (304, {"ETag": '"a"', "Retry-After": "1"}, b"")
    retried = [unchanged, refusal] if refusal[2].startswith(b"<") else []  # that may be a proxy, in between
    answers = [campaign("queued", ETag='"a"', **{"Retry-After": "1"}), refusal, *retried, unchanged, problem(503)]
    with server(*answers, campaign("succeeded", ETag='"b"')) as (client, script):
        assert [answer.state for answer in client.watch("0" * 32)] == ["queued", "succeeded"]
    asked = [headers.get("if-none-match") for _, path, headers, _ in script.requests if not path.endswith("/events")]
    assert asked == [None, *['"a"'] * (len(asked) - 1)]


def test_watching_gives_up_on_a_server_that_stays_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    do_not_wait(monkeypatch)
    monkeypatch.setattr(following, "SILENCE_SECONDS", 0.0)
    answers = [campaign("running", ETag='"a"'), problem(503), problem(503), problem(503)]
    with server(*answers) as (client, _), pytest.raises(UnavailableError):
        list(client.watch("0" * 32))


@pytest.mark.parametrize("content", ["no JSON", "[]", '{"kind": 5}', "{}"])
def test_a_stream_of_another_version_is_no_stream(monkeypatch: pytest.MonkeyPatch, content: str) -> None:
    do_not_wait(monkeypatch)
    strange: Answer = (200, {"Content-Type": "text/event-stream"}, f"event: best\nid: 1\ndata: {content}\n\n".encode())
    with server(strange) as (client, _), pytest.raises(UnavailableError):
        list(client.events("0" * 32))


def test_watching_a_server_that_never_answered_gives_up_at_once() -> None:
    with server(problem(503)) as (client, _), pytest.raises(UnavailableError):
        next(client.watch("0" * 32))


def test_watching_ends_at_its_deadline() -> None:
    with server(campaign("running", ETag='"a"')) as (client, _), pytest.raises(TimeoutError):
        list(client.watch("0" * 32, deadline=0.0))


def test_waiting_returns_the_ended_campaign() -> None:
    with server(campaign("succeeded")) as (client, _):
        assert client.wait("c1", timeout=300).state == "succeeded"


def parsed(*chunks: bytes) -> list[dict[str, str]]:
    parser = EventParser()
    return [item for chunk in chunks for item in parser.feed(chunk)]


def test_what_is_incomplete_or_no_text_ends_no_stream() -> None:
    assert parsed(b"data: \xff\n\nid: 1\n\n: nothing\n\ndata: begun\n") == [{"data": "\ufffd"}]


@given(st.lists(st.tuples(st.text(max_size=20), st.integers(0, 2**63 - 1)), max_size=5), st.lists(st.integers(0, 200)))
def test_what_the_server_writes_comes_out_however_it_is_cut(events: list[tuple[str, int]], cuts: list[int]) -> None:
    written = b"".join(
        KEEPALIVE_COMMENT + format_sse_event(event="note", id=str(number), data_str=json.dumps({"text": text}))
        for text, number in events
    )
    places = [0, *sorted(min(cut, len(written)) for cut in cuts), len(written)]
    pieces = [written[begin:end] for begin, end in pairwise(places)]
    expected = [{"event": "note", "id": str(number), "data": json.dumps({"text": text})} for text, number in events]
    assert parsed(*pieces) == expected


def test_waiting_for_hours_keeps_the_newest_state_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    known: list[weakref.ref[Campaign]] = []

    def states(*_: Any, **__: Any) -> Iterator[Campaign]:
        for number in range(5):
            state = Campaign(id="0" * 32, name=str(number), state="running")
            known.append(weakref.ref(state))
            yield state
            del state
            assert sum(each() is not None for each in known) == 1

    with Client("http://localhost", token="") as client:
        monkeypatch.setattr(client, "watch", states)
        assert client.wait("0" * 32, progress=False).name == "4"

"""Limits of single requests."""

import asyncio
import threading
from collections.abc import AsyncIterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from fastapi.responses import StreamingResponse
from fastapi.testclient import TestClient
from starlette.exceptions import HTTPException
from starlette.types import Message, Receive, Scope, Send
from tests.support.databases import migrated

from drivecal.api.app import create_app
from drivecal.api.dependencies import COMPUTED, COMPUTING, EventStreamPlace, Limits, computed
from drivecal.api.http import problems
from drivecal.api.http.limits import BodyLimit, Places
from drivecal.configuration.pushing import Pushing
from drivecal.configuration.settings import load_settings
from drivecal.domain.errors import OverloadError


def answer(messages: Sequence[Message], headers: dict[bytes, bytes]) -> tuple[int, dict[str, str], bytes]:
    """Status, headers and the read part of a body of at most ten bytes."""
    sent: list[Message] = []
    content = b""
    coming = list(messages)

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        nonlocal content
        del scope
        status = 200
        try:
            while True:
                message = await receive()
                content += message.get("body", b"")
                if not message.get("more_body", False):
                    break
        except HTTPException as error:
            status = error.status_code
        await send({"type": "http.response.start", "status": status, "headers": []})

    async def receive() -> Message:
        return coming.pop(0)

    async def send(message: Message) -> None:
        sent.append(message)

    scope: Scope = {"type": "http", "method": "POST", "path": "/", "query_string": b"", "headers": list(headers.items())}
    asyncio.run(BodyLimit(app, {"/": 10})(scope, receive, send))
    return sent[0]["status"], {name.decode(): value.decode() for name, value in sent[0]["headers"]}, content


def part(content: bytes, *, more: bool = False) -> Message:
    return {"type": "http.request", "body": content, "more_body": more}


CHUNKED = {b"transfer-encoding": b"chunked"}


def test_a_body_that_fits_is_passed_on() -> None:
    assert answer([part(b"0123456789")], {b"content-length": b"10"}) == (200, {}, b"0123456789")
    assert answer([part(b"01234", more=True), part(b"56789")], CHUNKED) == (200, {}, b"0123456789")


@pytest.mark.parametrize("declared", [b"11", b"500000000", b"9" * 30, b"-1", b"1e1", b"\xb2", b""])
def test_a_body_declared_too_large_is_not_read(declared: bytes) -> None:
    status, _, content = answer([part(b"0")], {b"content-length": declared})
    assert (status, content) == (413, b"")


def test_a_body_that_declares_its_length_twice_ends_its_connection() -> None:
    status, headers, content = answer([part(b"0")], {b"content-length": b"1", **CHUNKED})
    assert (status, headers["connection"], content) == (400, "close", b"")


def test_a_body_that_turns_out_too_large_is_read_no_further() -> None:
    status, _, content = answer([part(b"0" * 6, more=True)] * 3, CHUNKED)
    assert (status, content) == (413, b"0" * 6)


def test_there_are_no_more_places_than_there_are() -> None:
    places = Places(2, "chairs are taken", retry_seconds=7)
    with places.take():
        with places.take(), pytest.raises(OverloadError) as caught, places.take():
            pass
        assert caught.value.retry_seconds == 7
        with places.take(), pytest.raises(OverloadError), places.take():
            pass


def test_a_place_is_given_back_whatever_happens() -> None:
    places = Places(1, "chairs are taken", retry_seconds=1)
    with pytest.raises(ZeroDivisionError), places.take():
        raise ZeroDivisionError
    assert places.taken == 0


def test_event_streams_have_places_of_their_own_until_they_end() -> None:
    app = FastAPI()
    problems.install(app)
    go, listens = asyncio.Event(), asyncio.Semaphore(0)

    @app.get("/events")
    async def stream(place: EventStreamPlace) -> StreamingResponse:
        del place

        async def events() -> AsyncIterator[bytes]:
            listens.release()
            yield b"data: 1\n\n"
            await go.wait()

        return StreamingResponse(events(), media_type="text/event-stream")

    async def listen() -> None:
        limits = app.state.limits = Limits.of(load_settings(event_streams=2))
        transport = httpx.ASGITransport(app)
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            listening = [asyncio.create_task(client.get("/events")) for _ in range(2)]
            for _ in listening:
                await listens.acquire()
            assert limits.event_streams.taken == 2
            refused = await client.get("/events")
            assert refused.status_code == 429
            assert int(refused.headers["retry-after"]) > 0
            go.set()
            answers: list[Any] = [await listener for listener in listening]
            assert [answer.status_code for answer in answers] == [200, 200]
            assert limits.event_streams.taken == 0
            assert (await client.get("/events")).status_code == 200

    asyncio.run(listen())


def test_however_many_rankings_are_computed_other_answers_have_threads() -> None:
    app = FastAPI()
    problems.install(app)
    go, begun = threading.Event(), threading.Semaphore(0)

    @app.get("/ranking/{number}")
    @computed
    def ranking(number: int) -> int:
        begun.release()
        go.wait()
        return number

    @app.get("/readyz")
    def ready() -> str:
        return "ready"

    async def ask() -> None:
        limits = app.state.limits = Limits.of(load_settings())
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://localhost") as client:
            computing = [asyncio.create_task(client.get(f"/ranking/{number}")) for number in range(COMPUTED)]
            try:
                for _ in range(COMPUTING):
                    assert await asyncio.to_thread(begun.acquire, timeout=60.0)
                assert limits.computed.taken == COMPUTED > 40
                assert (await asyncio.wait_for(client.get("/readyz"), 60.0)).status_code == 200
                assert not begun.acquire(blocking=False), "no more are computed at a time"
                refused = await client.get("/ranking/0")
                assert refused.status_code == 429
                assert int(refused.headers["retry-after"]) > 0
            finally:
                go.set()
            assert [(await answer).json() for answer in computing] == list(range(COMPUTED))
            assert limits.computed.taken == 0
            assert (await client.get("/ranking/7")).json() == 7

    asyncio.run(ask())


def test_each_answer_that_is_computed_for_long_needs_a_place(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'drivecal.db'}"
    migrated(url).dispose()
    settings = load_settings(database_url=url, home=tmp_path / "home")
    app = create_app(settings, Pushing.of(settings, "127.0.0.1"))
    campaign = f"/api/v1/campaigns/{'0' * 32}"
    answers = ["solutions", "front", "front/summary", "front/evaluated"]
    answers += ["importance", "results", "setup", "calibration-file?format=dcm", "../../comparisons/none"]
    with TestClient(app, base_url="http://localhost:8000") as client:
        assert [client.get(f"{campaign}/{answer}").status_code for answer in answers] == [404] * len(answers)
        with ExitStack() as places:
            for _ in range(COMPUTED):
                places.enter_context(app.state.limits.computed.take())
            for answer in answers:
                refused = client.get(f"{campaign}/{answer}")
                assert (answer, refused.status_code, int(refused.headers["retry-after"]) > 0) == (answer, 429, True)
            assert client.get("/readyz").json()["ready"] is False, "there is no dispatcher, and that is said"
            assert client.get("/api/v1/campaigns").status_code == 200
        assert client.get(f"{campaign}/solutions").status_code == 404

"""Log and metrics of each request; the application behind it does what each test needs."""

import asyncio
import logging
import re
from pathlib import Path
from typing import Any

import pytest
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from drivecal.api.http.requests import RequestRecords
from drivecal.api.metrics import Meters
from drivecal.configuration import logs
from drivecal.storage.engine.database import Database


@pytest.fixture
def meters(tmp_path: Path) -> Meters:
    return Meters(Database.open(f"sqlite:///{tmp_path / 'drivecal.db'}"))


def answering(status: int = 200, content_type: str = "application/json", **scope_entries: Any) -> ASGIApp:
    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        del receive
        scope.update(scope_entries)
        logs.note(token="anna")
        headers = [(b"content-type", content_type.encode())]
        await send({"type": "http.response.start", "status": status, "headers": headers})

    return app


def ask(meters: Meters, app: ASGIApp, method: str = "GET", request_id: str | None = None, path: str = "/x") -> dict[str, str]:
    """The headers of the answer."""
    sent: list[Message] = []

    async def send(message: Message) -> None:
        sent.append(message)

    async def receive() -> Message:
        raise AssertionError("nothing is read")

    headers = [] if request_id is None else [(b"x-request-id", request_id.encode("latin-1"))]
    scope: Scope = {"type": "http", "method": method, "path": path, "query_string": b"token=geheim", "headers": headers}
    asyncio.run(RequestRecords(app, meters)(scope, receive, send))
    return {name.decode(): value.decode() for name, value in sent[0]["headers"]}


def sample(meters: Meters, name: str, **labels: str) -> float | None:
    return meters.registry.get_sample_value(name, labels)


@pytest.mark.parametrize("given", ["7f3a", "a.b:c/d+e=f-g_h", "x" * 100])
def test_a_sane_request_id_is_kept(meters: Meters, given: str) -> None:
    assert ask(meters, answering(), request_id=given)["x-request-id"] == given


@pytest.mark.parametrize("given", [None, "", "x" * 101, "a b", "é", "a\n2026 info", '"'])
def test_any_other_is_replaced(meters: Meters, given: str | None) -> None:
    assert re.fullmatch(r"[0-9a-f]{32}", ask(meters, answering(), request_id=given)["x-request-id"])


def test_changes_are_logged_at_info_and_questions_at_debug(meters: Meters, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG, "drivecal.api"):
        ask(meters, answering(202, path_params={"campaign_id": "c1"}), "POST", path="/api/v1/campaigns/c1/pause")
        ask(meters, answering(503), "GET")
    change, question = caplog.records
    assert (change.levelname, change.getMessage()) == ("INFO", "POST /api/v1/campaigns/c1/pause: 202")
    assert change.__dict__["campaign"] == "c1"
    assert change.__dict__["milliseconds"] >= 0
    assert (question.levelname, question.__dict__["status"]) == ("DEBUG", 503)
    assert "geheim" not in caplog.text + str([record.__dict__ for record in caplog.records])


def test_an_error_that_is_answered_outside_counts_as_one(meters: Meters) -> None:
    async def failing(*_: object) -> None:
        raise RuntimeError("a bug")

    with pytest.raises(RuntimeError):
        ask(meters, failing)
    assert sample(meters, "drivecal_http_requests_total", route="none", method="GET", status="500") == 1


def test_an_event_stream_has_no_duration(meters: Meters) -> None:
    ask(meters, answering(content_type="text/event-stream; charset=utf-8"))
    assert sample(meters, "drivecal_http_requests_total", route="none", method="GET", status="200") == 1
    assert sample(meters, "drivecal_http_request_seconds_count", route="none", method="GET") is None


def test_a_stranger_cannot_make_a_series_of_their_own(meters: Meters) -> None:
    for number in range(20):
        ask(meters, answering(404), f"BREW{number}", path=f"/{number}")
    assert sample(meters, "drivecal_http_requests_total", route="none", method="other", status="404") == 20

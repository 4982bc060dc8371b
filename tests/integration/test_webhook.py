"""The posts of the webhook reach a real listener."""

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import pytest
from tests.support.databases import migrated
from tests.support.fake_backend import FakeBackend
from tests.support.runs import dispatcher, submit

from drivecal.dispatch.webhook import NAME, Webhook
from drivecal.domain.campaigns import CampaignState
from drivecal.execution.pool import WorkPool
from drivecal.storage import campaigns, events, processes
from drivecal.storage.engine.database import Database


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    opened = migrated(f"sqlite:///{tmp_path}/drivecal.db")
    yield opened
    opened.dispose()


@contextmanager
def listening(*statuses: int) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """A listener that answers with these statuses, then 204: its address with a secret, and what was posted to it."""
    posted: list[dict[str, Any]] = []
    answers = list(statuses)

    class Listener(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            posted.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(answers.pop(0) if answers else 204)
            self.send_header("Location", "/elsewhere")
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Listener) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/hook?secret=hunter2", posted
        server.shutdown()
        thread.join()


def end(database: Database, state: CampaignState = CampaignState.SUCCEEDED, error: str | None = None) -> str:
    campaign = submit(database)
    with database.transaction() as connection:
        campaigns.end(connection, campaign.sequence, state, error)
    return campaign.id


def test_an_end_and_a_degradation_are_posted_once_each_with_attempts_until_they_are_taken(database: Database) -> None:
    with listening(500, 302) as (url, posted):
        hook = Webhook(database, url, pauses=(0.0, 0.0))
        end(database)
        hook.post()
        assert posted == [], "what ended before the first start is not told"
        failed = end(database, CampaignState.FAILED, "the password is hunter3")
        hook.post()
        assert [each["event"] for each in posted] == ["failed"] * 3
        assert len({each["number"] for each in posted}) == 1
        assert posted[-1]["campaign"] == {
            "id": failed, "name": "test", "state": "failed", "objective": None, "baseline": None
        }  # fmt: skip
        assert posted[-1]["path"] == f"/api/v1/campaigns/{failed}"
        assert "hunter" not in json.dumps(posted)
        running = submit(database)
        with database.transaction() as connection:
            campaigns.degrade(connection, [running.sequence], "no worker")
        hook.post()
        Webhook(database, url).post()
        assert [each["event"] for each in posted[3:]] == ["degraded"]


def test_what_is_not_marked_is_posted_again(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    with listening() as (url, posted):
        Webhook(database, url).post()
        campaign = end(database)

        def crash(*_: Any) -> None:
            raise SystemExit

        with monkeypatch.context() as patched:
            patched.setattr(Webhook, "_mark", crash)
            with pytest.raises(SystemExit):
                Webhook(database, url).post()
        Webhook(database, url).post()
        assert [each["campaign"]["id"] for each in posted] == [campaign] * 2


def test_a_listener_that_never_takes_an_event_holds_nothing_up_and_stays_secret(
    database: Database, caplog: pytest.LogCaptureFixture
) -> None:
    with listening(*[500] * 2) as (url, posted):
        hook = Webhook(database, url, pauses=(0.0,))
        hook.post()
        given_up, taken = end(database), end(database)
        hook.post()
        assert [each["campaign"]["id"] for each in posted] == [given_up, given_up, taken]
    assert given_up in caplog.text
    assert "hunter2" not in caplog.text
    Webhook(database, url, pauses=()).post()
    with database.read() as connection:
        assert processes.read(connection, NAME) is not None


def test_a_campaign_whose_cells_wait_without_a_result_stalls_once(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivecal.dispatch.dispatcher.STALL_SECONDS", 60.0)
    carrying_out = dispatcher(database, FakeBackend(2))
    campaign = submit(database)
    carrying_out.step()
    monkeypatch.setattr(WorkPool, "waits", lambda *_: "2 cells wait for carmaker")
    monkeypatch.setattr(WorkPool, "poll", lambda *_: [])
    for _ in range(80):
        carrying_out.step()
    with database.read() as connection:
        told = [event for event in events.since(connection, campaign.sequence, 0, 100) if event.kind == "stalled"]
    assert [event.data["reason"] for event in told] == ["2 cells wait for carmaker"]

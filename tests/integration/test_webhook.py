"""The posts of the webhook reach a real listener."""

import json
import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from tests.support.deaths import InterceptedDatabase
from tests.support.fake_backend import FakeBackend
from tests.support.problems import store
from tests.support.runs import dispatcher, get, step_until, submit, told_of
from tests.support.scripted import Answer, Request, listening

from drivecal.api import submission
from drivecal.api.dependencies import Limits
from drivecal.configuration.settings import load_settings
from drivecal.contracts.specification import CampaignSpecification
from drivecal.dispatch import webhook
from drivecal.dispatch.dispatcher import Dispatcher
from drivecal.dispatch.heartbeat import Leadership
from drivecal.dispatch.webhook import NAME, Webhook
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.events import EventKind
from drivecal.execution.pool import Leases, WorkPool
from drivecal.execution.scheduling.resources import Resources
from drivecal.storage import campaigns, processes
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database


@contextmanager
def hooked(*statuses: int) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """A listener that answers with these statuses, then 204: its address with a secret, and what was posted to it."""
    posted: list[dict[str, Any]] = []
    answers = list(statuses)

    def answer(request: Request) -> Answer:
        posted.append(json.loads(request[-1]))
        return answers.pop(0) if answers else 204, {"Location": "/elsewhere"}, b""

    with listening(answer) as address:
        yield f"{address}/hook?secret=hunter2", posted


def end(database: Database, state: CampaignState = CampaignState.SUCCEEDED, error: str | None = None) -> str:
    campaign = submit(database)
    with database.transaction() as connection:
        campaigns.end(connection, campaign.sequence, state, error)
    return campaign.id


def test_an_end_and_a_degradation_are_posted_once_each_with_attempts_until_they_are_taken(database: Database) -> None:
    with hooked(500, 302) as (url, posted):
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
            campaigns.start(connection, running.sequence)
            campaigns.degrade(connection, [running.sequence], "no worker")
        hook.post()
        Webhook(database, url).post()
        assert [each["event"] for each in posted[3:]] == ["degraded"]


def test_what_is_not_marked_is_posted_again(database: Database) -> None:
    with hooked() as (url, posted):
        Webhook(database, url).post()
        campaign = end(database)

        def crash(_: str) -> None:
            if posted:
                raise SystemExit

        intercepted: Any = InterceptedDatabase(database, crash)
        with pytest.raises(SystemExit):
            Webhook(intercepted, url).post()
        Webhook(database, url).post()
        assert [each["campaign"]["id"] for each in posted] == [campaign] * 2


def test_a_refusing_listener_holds_nothing_up_and_stays_secret(database: Database, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    with hooked(*[500] * 2) as (url, posted):
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


@pytest.mark.slow
def test_many_events_at_a_time_and_single_evaluations_hide_no_later_event(database: Database) -> None:
    with hooked() as (url, posted):
        hook = Webhook(database, url)
        hook.post()
        for _ in range(110):
            with database.transaction() as connection:
                one = campaigns.insert(connection, name="one", spec={}, kind="evaluation")
                campaigns.end(connection, one.sequence, CampaignState.SUCCEEDED)
        ended = [end(database)]
        hook.post()
        assert [each["campaign"]["id"] for each in posted] == ended
        ended += [end(database) for _ in range(110)]
        for _ in range(3):
            hook.post()
        assert [each["campaign"]["id"] for each in posted] == ended


def test_posting_goes_on_after_an_unexpected_fault(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(webhook, "AFTER_FAULT_SECONDS", 0.0)
    again, calls = threading.Event(), iter([RuntimeError])

    def post(self: Webhook) -> None:
        del self
        for error in calls:
            raise error
        again.set()

    monkeypatch.setattr(Webhook, "post", post)
    with Webhook(database, "http://localhost"):
        assert again.wait(60)


def test_a_superseded_dispatcher_posts_and_logs_nothing(database: Database, caplog: pytest.LogCaptureFixture) -> None:
    before = database.fenced(Leadership.begin(database).fence)
    Leadership.begin(database)
    with hooked() as (url, posted), caplog.at_level(logging.INFO), Webhook(before, url):
        for thread in threading.enumerate():
            if thread.name == "webhook":
                thread.join()
        assert posted == []
    assert caplog.text == ""


LICENSED: dict[str, Any] = {
    "problem": "licensed",
    "parameters": {"x": {"lower": 0, "upper": 1}},
    "simulator": {"kind": "command", "command": ["sh", "-c", "{parameters} {results}"], "resources": {"carmaker": 1}},
    "scenarios": {"city": {}, "road": {}},
    "measures": {"m": "1"},
    "scores": {"s": {"formula": "m", "direction": "minimise", "range": [0, 1]}},
}


def stalls(database: Database, campaign: StoredCampaign) -> list[str]:
    """The reasons of the stalls that were told."""
    return [event.data["reason"] for event in told_of(database, campaign) if event.kind == EventKind.STALLED]


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stall takes a minute."""
    monkeypatch.setattr("drivecal.dispatch.dispatcher.STALL_SECONDS", 60.0)


@pytest.mark.usefixtures("short")
def test_a_campaign_without_results_stalls_once_in_streams(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    carrying_out = dispatcher(database, FakeBackend(2))
    campaign = submit(database)
    carrying_out.step()
    monkeypatch.setattr(WorkPool, "waits", lambda *_, **__: "2 cells wait for carmaker")
    monkeypatch.setattr(WorkPool, "poll", lambda *_: [])
    revisions = {False: 0, True: 0}
    for _ in range(80):
        carrying_out.step()
        told = stalls(database, campaign) != []
        revisions[told] = revisions[told] or get(database, campaign).revision
    assert stalls(database, campaign) == ["2 cells wait for carmaker"]
    assert 0 < revisions[False] < revisions[True]


@pytest.mark.usefixtures("short")
def test_a_campaign_whose_own_run_holds_the_only_licence_has_not_stalled(database: Database) -> None:
    store(database, LICENSED)
    optimizer = {"kind": "random", "population": 5, "iterations": 1}
    document = CampaignSpecification.model_validate({"problem": "licensed", "optimizer": optimizer})
    campaign = submission.submit(database, Limits.of(load_settings(resources="carmaker=1")), document, None)
    backend = FakeBackend(2, {"city": 900.0, "road": 900.0})
    own = database.fenced(Leadership.begin(database).fence)
    pool = WorkPool(backend, Leases(own), clock=lambda: backend.now, resources=Resources({"carmaker": 1}))
    carrying_out = Dispatcher(own, pool, clock=lambda: backend.now)
    while not backend.sizes:  # the optimizer computes
        carrying_out.step()
    begun = backend.now
    while backend.now < begun + 600.0:
        carrying_out.step()
        backend.now += 5.0
    assert pool.waits(campaign.id) is not None
    assert stalls(database, campaign) == []


@pytest.mark.usefixtures("short")
def test_hours_without_waiting_cells_are_no_part_of_a_stall(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    reason: list[str] = []
    looks: list[str] = []

    def waits(*_: object, **__: bool) -> str | None:
        looks.extend(reason)
        return next(iter(reason), None)

    carrying_out = dispatcher(database)
    campaign = submit(database)
    step_until(database, campaign, 1, carrying_out)
    monkeypatch.setattr(WorkPool, "waits", waits)
    monkeypatch.setattr(WorkPool, "poll", lambda *_: [])
    for _ in range(80):
        carrying_out.step()
    reason.append("1 cell waits for carmaker")
    while len(looks) < 5:
        carrying_out.step()
    assert stalls(database, campaign) == []
    for _ in range(80):
        carrying_out.step()
    assert stalls(database, campaign) == reason

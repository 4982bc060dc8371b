"""Reports of a dispatcher that has stopped reporting, and a server's health."""

from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from drivecal.api.live.dispatcher_health import AHEAD, SILENT_SECONDS, degraded, judge, silence, silent_seconds
from drivecal.api.responses import etag, list_etag, matches
from drivecal.domain.campaigns import Action, CampaignState
from drivecal.storage.processes import StoredProcess
from drivecal.storage.revision_queries import CampaignRevision

NOW = datetime(2026, 1, 1, tzinfo=UTC)


def campaign_revision(
    state: CampaignState = CampaignState.RUNNING, asked: Action | None = None, revision: int = 7, degraded: str | None = None
) -> CampaignRevision:
    return CampaignRevision(1, "c0ffee", state, asked, revision, degraded, None)


@pytest.mark.parametrize(
    ("seconds", "said"),
    [
        (-1, None),
        (0, None),
        (SILENT_SECONDS, None),
        (4.1, "more than 4 s"),
        (9, "more than 4 s"),
        (11, "more than 10 s"),
        (59, "more than 30 s"),
        (61, "more than a minute"),
        (10_000_000, "more than an hour"),
    ],
)
def test_a_silence_is_told_in_words_that_stay_the_same_for_a_while(seconds: float, said: str | None) -> None:
    result = silence(NOW - timedelta(seconds=seconds), NOW)
    assert result == (None if said is None else f"the dispatcher has been silent for {said}")


def test_a_heartbeat_from_before_a_clock_was_set_back_hides_no_dispatcher_that_is_gone() -> None:
    assert silence(NOW + timedelta(hours=1), NOW) == AHEAD


def test_a_dispatcher_that_never_spoke_is_not_running() -> None:
    assert silence(None, NOW) == "no dispatcher is running"


@pytest.mark.parametrize(
    ("state", "asked", "waits"),
    [
        (CampaignState.QUEUED, None, True),
        (CampaignState.RUNNING, None, True),
        (CampaignState.RUNNING, "pause", True),
        (CampaignState.CANCELLING, None, True),
        (CampaignState.PAUSED, None, False),
        (CampaignState.PAUSED, "resume", True),
        (CampaignState.SUCCEEDED, None, False),
        (CampaignState.FAILED, None, False),
        (CampaignState.CANCELLED, None, False),
    ],
)
def test_a_silent_dispatcher_degrades_what_waits_for_it(state: CampaignState, asked: Action | None, *, waits: bool) -> None:
    assert degraded(campaign_revision(state, asked), "silent") == ("silent" if waits else None)


def test_what_the_dispatcher_said_last_is_told_with_its_silence() -> None:
    assert degraded(campaign_revision(degraded="no workers"), None) == "no workers"
    assert degraded(campaign_revision(degraded="no workers"), "silent") == "silent; it last said: no workers"


def test_the_tag_changes_with_the_revision_and_with_what_is_said() -> None:
    tags = {
        etag(campaign_revision(), None),
        etag(campaign_revision(revision=8), None),
        etag(campaign_revision(), "silent"),
        etag(campaign_revision(degraded="no workers"), None),
        etag(campaign_revision(degraded="no workers"), "silent"),
    }
    assert len(tags) == 5
    assert etag(campaign_revision(), None) == etag(campaign_revision(), None)
    assert all(tag.startswith('W/"c0ffee-') for tag in tags)
    pages = {
        list_etag([], None),
        list_etag([campaign_revision()], None),
        list_etag([campaign_revision(), campaign_revision()], None),
        list_etag([campaign_revision()], "silent"),
        list_etag([campaign_revision(revision=8)], None),
    }
    assert len(pages) == 5


@pytest.mark.parametrize(
    ("given", "fits"),
    [
        (None, False),
        ("", False),
        ('W/"a-1-0"', True),
        ('"a-1-0"', True),
        ('"x", W/"a-1-0"', True),
        ("*", True),
        ('W/"a-2-0"', False),
        ("a-1-0", False),
    ],
)
def test_tags_are_compared_weakly(given: str | None, fits: bool) -> None:
    assert matches(given, 'W/"a-1-0"') is fits


def dispatcher(silent: float = 0.5, states: tuple[str, ...] = ("idle",), degraded: str | None = None) -> StoredProcess:
    detail: dict[str, Any] = {"workers": [{"state": state} for state in states], "degraded": degraded}
    return StoredProcess("dispatcher", 1, NOW, NOW - timedelta(seconds=silent), detail, 1)


@pytest.mark.parametrize(
    ("found", "ready", "words"),
    [
        (
            None,
            False,
            "no dispatcher has started yet; `drivecal serve` starts one, and in a cluster its log says what keeps it",
        ),
        (dispatcher(), True, None),
        (dispatcher(states=("starting", "busy")), True, None),
        (dispatcher(degraded="1 of 2 workers do not start"), True, "1 of 2 workers do not start"),
        (dispatcher(states=("starting",), degraded="1 of 1 workers do not start"), False, "1 of 1 workers do not start"),
        (dispatcher(states=("starting",)), False, "the dispatcher has no worker yet: its worker is starting"),
        (dispatcher(states=("starting",) * 4), False, "the dispatcher has no worker yet: its 4 workers are starting"),
        (dispatcher(states=()), False, "the dispatcher has no worker yet: wait for it to start them"),
        (dispatcher(states=(), degraded="Ray does not answer"), False, "Ray does not answer"),
        (dispatcher(silent=5), True, "the dispatcher has been silent for 5 s"),
        (dispatcher(silent=11), False, "the dispatcher has been silent for 11 s"),
        (dispatcher(silent=-3), True, None),
        (dispatcher(silent=-3600), False, "the dispatcher's last heartbeat is later than this clock"),
    ],
)
def test_ready_is_who_can_have_a_campaign_simulated(found: StoredProcess | None, ready: bool, words: str | None) -> None:
    judgement = judge(found, NOW)
    assert judgement.ready is ready
    if words is None:
        assert judgement.problems == ()
    else:
        assert judgement.problems[0].startswith(words)


def test_a_dispatcher_that_died_degraded_is_silent_first_and_degraded_second() -> None:
    judgement = judge(dispatcher(silent=60, degraded="Ray does not answer"), NOW)
    assert (judgement.ready, judgement.silent, len(judgement.problems)) == (False, True, 2)
    assert judgement.problems[1] == "it last said: Ray does not answer", "what it said is no state of now"


def test_an_age_is_never_negative_and_large_if_clocks_differ_much() -> None:
    assert [silent_seconds(dispatcher(silent=age), NOW) for age in (-3, 2, -3600)] == [0.0, 2.0, 3600.0]

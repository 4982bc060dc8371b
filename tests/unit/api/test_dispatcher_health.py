from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from drivecal.api.live.dispatcher_health import judge, silent_seconds
from drivecal.storage.processes import StoredProcess

NOW = datetime(2026, 1, 1, tzinfo=UTC)


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

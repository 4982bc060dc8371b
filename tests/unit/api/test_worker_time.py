"""Windows of time with the work of each worker."""

from datetime import UTC, datetime, timedelta

import pytest

from drivecal.api.live.worker_time import MOST_RUNS, RUNNING, window
from drivecal.storage.references.runs import Worked

UNTIL = datetime(2026, 11, 26, 12, tzinfo=UTC)
NAMES = {1: ("a", "first"), 2: ("b", "second")}


def run(seconds_ago: float, seconds: float, campaign: int = 1, worker: str = "w") -> Worked:
    return Worked(worker, campaign, UNTIL - timedelta(seconds=seconds_ago), seconds)


def test_runs_that_are_stored_together_lie_end_to_end() -> None:
    done = window([run(0, 10), run(0, 20, 2), run(0, 30), run(3590, 30)], UNTIL, 60, NAMES)
    (time,) = done.workers
    assert (time.runs, time.busy[0], time.busy[-1]) == (4, 10, 60)  # the first run began before the window
    assert (time.campaigns[-1], time.campaigns[1]) == ("a", None)
    assert sum(time.busy) == pytest.approx(70)
    assert done.names == {"a": "first", "b": "second"}


def test_a_run_spreads_over_the_parts_that_it_took_and_one_that_runs_has_no_campaign() -> None:
    (time,) = window([run(0, 30, RUNNING), run(60, 90, 2), run(180, 60, 3)], UNTIL, 60, NAMES).workers
    assert (time.runs, time.busy[-4:]) == (2, [60, 30, 60, 30])
    assert time.campaigns[-4:] == ["deleted", "b", "b", None]


def test_a_window_says_since_when_it_holds_all_runs() -> None:
    work = [run(0, 0.001) for _ in range(MOST_RUNS - 1)] + [run(300, 1)]
    assert window(work, UNTIL, 15, NAMES).complete_since == UNTIL - timedelta(seconds=300)
    assert window(work[1:], UNTIL, 15, NAMES).complete_since == UNTIL - timedelta(minutes=15)

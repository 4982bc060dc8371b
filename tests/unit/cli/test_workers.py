from datetime import UTC, datetime, timedelta

from drivecal.cli.commands.serve import doing, remarks
from drivecal.contracts.inventory import WaitingAnswer, WorkerAnswer, WorkerPage

NOW = datetime(2026, 1, 1, tzinfo=UTC)


def test_a_busy_worker_says_what_it_simulates_and_for_how_long() -> None:
    assert doing(WorkerAnswer(id="w", state="idle"), NOW) is None
    busy = WorkerAnswer(id="w", state="busy", scenario="S3", since=NOW - timedelta(seconds=75))
    assert doing(busy, NOW) == "S3 for 1 min 15 s"
    assert doing(busy, NOW - timedelta(hours=1)) == "S3 for 0 s", "its clock is ahead"


def test_what_a_silent_dispatcher_said_is_marked_as_old() -> None:
    page = WorkerPage(
        items=[WorkerAnswer(id="w", state="busy")],
        dispatcher_seen_at=NOW - timedelta(minutes=3),
        degraded="the dispatcher has been silent for 180 s",
    )
    assert remarks(page, NOW) == [
        "degraded: the dispatcher has been silent for 180 s",
        "this is what the dispatcher said 3 min 00 s ago, before it fell silent",
    ]
    assert remarks(page.model_copy(update={"fresh": True, "degraded": None}), NOW) == []
    waiting = [WaitingAnswer(id="0123456789", name="night", reason="2 of 2 licences are in use")]
    [line] = remarks(WorkerPage(items=[], fresh=True, waiting=waiting), NOW)
    assert all(word in line for word in ("night", "01234567", "2 of 2 licences"))

"""The progress of a campaign on a terminal, and time limits of waiting."""

from collections.abc import Iterator
from contextlib import nullcontext
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console
from typer.testing import CliRunner

from drivecal.cli.__main__ import app
from drivecal.cli.views import output, progress
from drivecal.cli.views.progress import Bar, progress_line, show_until_ended
from drivecal.client.client import Client
from drivecal.contracts.campaign import Campaign, CellCounts, Progress
from drivecal.contracts.inventory import WorkerAnswer, WorkerPage
from drivecal.domain.errors import UnavailableError


@pytest.mark.parametrize("width", [80, 120, 200])
def test_the_progress_is_one_line_with_its_stage_and_count_in_any_width(width: int) -> None:
    written = StringIO()
    console = Console(width=width, file=written)
    progress = progress_line(console)
    cells = CellCounts(proposed=120_000, requested=59_000, simulated=12_345, reused=23_456, predicted=23_199)
    campaign = Campaign(
        id="1" * 32,
        name="long",
        state="running",
        stage="calibration",
        iteration=11,
        stages={"calibration": cells},
        progress=Progress(done=60_000, total=120_000, eta_seconds=180),
        degraded="the dispatcher has been silent for a long time, and nobody knows when it will be back",
    )
    Bar(progress).show(campaign)
    console.print(progress.get_renderable())
    [line] = written.getvalue().splitlines()
    assert "calibration" in line
    assert "60000/120000" in line
    assert len(line) <= width


class Watched(Client):
    """A client of a campaign that is queued, runs and ends, while workers have these states; None: the server is silent."""

    def __init__(self, *workers: list[str] | None) -> None:
        self.replies = list(workers)

    def watch(self, *_: Any, **__: Any) -> Iterator[Campaign]:
        for state in ("queued", "running", "running", "succeeded"):
            yield Campaign(id="1" * 32, name="mine", state=state)

    def workers(self, minutes: int = 0) -> WorkerPage:
        del minutes
        states = self.replies.pop(0)
        if states is None:
            raise UnavailableError("silent")
        return WorkerPage(items=[WorkerAnswer(id=str(place), state=state) for place, state in enumerate(states)], fresh=True)


@pytest.mark.parametrize(
    ("workers", "told", "asked"),
    [
        ([["starting", "starting"]], 1, 1),
        ([["starting", "idle"]], 0, 1),
        ([[], ["starting"]], 1, 2),
        ([None, [], ["busy"]], 0, 3),
    ],
)
def test_why_nothing_is_simulated_is_told_once_if_workers_are_starting(
    capsys: pytest.CaptureFixture[str], workers: list[list[str] | None], told: int, asked: int
) -> None:
    client = Watched(*workers, *[["starting"]] * 9)
    assert show_until_ended(client, "1" * 32).state == "succeeded"
    assert capsys.readouterr().err.count("waiting for workers") == told
    assert len(client.replies) == len(workers) + 9 - asked


def test_an_evaluation_and_its_time_series_have_one_time_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    paused: list[float] = []
    answers = iter([SimpleNamespace(id="e", state=state) for state in ("running", "running", "succeeded")])
    client = SimpleNamespace(evaluate=lambda _: next(answers), evaluation=lambda _: next(answers), trace=lambda _: None)
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: sum(paused), sleep=paused.append))
    monkeypatch.setattr(output, "connect", lambda _: nullcontext(client))
    given = ["evaluate", "x=1", "--scenario", "s", "--trace", str(tmp_path / "run.csv"), "--timeout", "0.8"]
    assert CliRunner().invoke(app, given).exit_code == 6
    assert sum(paused) < 1.2

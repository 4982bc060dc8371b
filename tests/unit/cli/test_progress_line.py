"""The progress of a campaign on a terminal, and time limits of waiting."""

from contextlib import nullcontext
from io import StringIO
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console
from typer.testing import CliRunner

from drivecal.cli.__main__ import app
from drivecal.cli.views import output, progress
from drivecal.cli.views.progress import Bar, Lines, progress_line
from drivecal.contracts.campaign import Campaign, CellCounts, Progress


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


def test_the_reason_why_nothing_is_simulated_is_in_the_line(capsys: pytest.CaptureFixture[str]) -> None:
    Lines().show(Campaign(id="1" * 32, name="mine", state="running", waiting="no worker is ready yet"))
    assert capsys.readouterr().err == "running  waiting: no worker is ready yet\n"


def test_an_evaluation_and_its_time_series_have_one_time_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    paused: list[float] = []
    answers = iter([SimpleNamespace(id="e", state=state) for state in ("running", "running", "succeeded")])
    client = SimpleNamespace(evaluate=lambda _: next(answers), evaluation=lambda _: next(answers), trace=lambda _: None)
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: sum(paused), sleep=paused.append))
    monkeypatch.setattr(output, "connect", lambda _: nullcontext(client))
    given = ["evaluate", "x=1", "--scenario", "s", "--trace", str(tmp_path / "run.csv"), "--timeout", "0.8"]
    assert CliRunner().invoke(app, given).exit_code == 6
    assert sum(paused) < 1.2

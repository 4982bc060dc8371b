"""The progress of a campaign on a terminal."""

from __future__ import annotations

from io import StringIO

import pytest
from rich.console import Console

from drivecal.cli.views.progress import Bar, progress_line
from drivecal.contracts.campaign import Campaign, CellCounts, Progress


@pytest.mark.parametrize("width", [80, 120, 200])
def test_the_progress_is_one_line_with_its_stage_and_count_in_any_width(width: int) -> None:
    written = StringIO()
    console = Console(width=width, file=written)
    progress = progress_line(console)
    cells = CellCounts(proposed=120_000, requested=59_000, simulated=12_345, reused=23_456, predicted=3_456, certified=19_743)
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

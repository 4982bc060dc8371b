"""The table of `drivecal top`, drawn and printed."""

from __future__ import annotations

import io
import json
import re
import time

import pytest
from rich.console import Console

from drivecal.cli.views.live_table import SearchedCampaign, document, print_plain, show_live, sparkline, table
from drivecal.cli.views.output import OUTCOME_COLOURS
from drivecal.contracts.campaign import Best, Campaign, CellCounts, Progress
from drivecal.domain.errors import UnavailableError

RUNNING = SearchedCampaign(
    Campaign(
        id="0a1b2c3d" + "0" * 24,
        name="[bold]mine[/x]",
        state="running",
        stage="calibration",
        iteration=2,
        progress=Progress(done=30, total=120, eta_seconds=75.0),
        best=Best(objective=5.5, parameters={"P1": 1.0}, scores={"S1": 5.5}, alternatives=1),
        stages={"calibration": CellCounts(requested=1300, simulated=1234, reused=66)},
        spec={"optimizer": {"iterations": 8}},
    ),
    (3.0, 4.0, 5.5),
)
FAILED = SearchedCampaign(Campaign(id="f" * 32, name="other", state="failed", error="no [worker] agrees"))


def terminal(width: int = 160) -> Console:
    return Console(file=io.StringIO(), force_terminal=True, color_system="truecolor", width=width)


def drawn(console: Console) -> str:
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


@pytest.mark.parametrize(
    ("values", "width", "line"),
    [
        ((), 8, ""),
        ((3.0,), 8, "▁"),
        ((2.0, 2.0), 8, "▁▁"),
        ((0.0, 3.5, 7.0), 8, "▁▅█"),
        ((9.0, 1.0), 8, "█▁"),
        (tuple(range(100)), 4, "▁▃▆█"),
    ],
)
def test_a_sparkline_shows_the_course_of_values(values: tuple[float, ...], width: int, line: str) -> None:
    assert sparkline(values, width) == line


def test_the_last_value_is_always_shown() -> None:
    for count in range(1, 60):
        values = [0.0] * (count - 1) + [1.0]
        assert len(sparkline(values, 7)) == min(count, 7)
        assert sparkline([0.0, *values], 7)[-1] == "█"


def test_without_a_terminal_a_campaign_is_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    print_plain([RUNNING, FAILED])
    header, running, failed = capsys.readouterr().out.splitlines()
    assert [name in header for name in ("simulated", "reused", "predicted")] == [True, True, False]
    for part in ("0a1b2c3d", "calibration 3/8", "25% of 120", "1,234", "▁▄█", "5.500", "1 min 15 s", "[bold]mine[/x]"):
        assert part in running
    assert failed.split()[:2] == ["ffffffff", "failed"]


@pytest.mark.parametrize("width", [60, 80, 120, 160])
def test_a_campaign_is_one_line_with_its_id_and_best_value_at_every_width(width: int) -> None:
    console = terminal(width)
    console.print(table([RUNNING], console.width))
    _, line = re.sub(r"\x1b\[[\d;]*m", "", drawn(console)).splitlines()
    assert len(line) <= width
    assert all(part in line for part in ("0a1b2c3d", "running", "25% of 120", "5.500", "[bold]mine"))
    assert ("1,234" in line) == (width > 100)


def test_on_a_terminal_outcomes_have_their_colours_and_names_are_text() -> None:
    console = terminal()
    console.print(table([RUNNING, FAILED], console.width))
    red, green, blue = (int(OUTCOME_COLOURS["reused"][place : place + 2], 16) for place in (1, 3, 5))
    assert re.search(rf"38;2;{red};{green};{blue}m +66\b", drawn(console))
    assert "[bold]mine[/x]" in drawn(console)
    assert "no [worker] agrees" in drawn(console)


def test_programs_get_the_same_as_json() -> None:
    running, failed = json.loads(json.dumps(document([RUNNING, FAILED])))["items"]
    assert running["outcomes"] == dict.fromkeys(OUTCOME_COLOURS, 0) | {"simulated": 1234, "reused": 66}
    assert running["best_by_iteration"] == [3.0, 4.0, 5.5]
    assert running["progress"] == {"done": 30, "total": 120, "eta_seconds": 75.0}
    assert failed["error"] == "no [worker] agrees"


def test_the_live_table_outlives_a_restart_of_the_server_and_ends_with_ctrl_c(monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[float] = []
    monkeypatch.setattr(time, "sleep", waits.append)
    answers: list[list[SearchedCampaign] | BaseException] = [
        [RUNNING],
        UnavailableError("it is away"),
        [FAILED],
        KeyboardInterrupt(),
    ]

    def read() -> list[SearchedCampaign]:
        answer = answers.pop(0)
        if isinstance(answer, BaseException):
            raise answer
        return answer

    console = terminal()
    show_live(read, 2.0, console)
    assert answers == []
    assert set(waits) == {2.0}
    shown = drawn(console)
    assert shown.index("0a1b2c3d") < shown.index("it is away") < shown.index("ffffffff")
    assert shown.rindex("\x1b[?25h") > shown.rindex("\x1b[?25l"), "the cursor is back"


def test_a_server_that_never_answered_is_an_error() -> None:
    def read() -> list[SearchedCampaign]:
        raise UnavailableError("nothing answers")

    with pytest.raises(UnavailableError):
        show_live(read, 2.0, terminal())

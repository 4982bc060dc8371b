"""Output of the command line, and files that it writes to standard output: they hold names and messages of other people."""

import io
import os
import time
from contextlib import nullcontext
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import pytest
from rich.console import Console
from rich.progress import Progress as RichProgress
from rich.progress import TextColumn
from typer.testing import CliRunner

from drivecal.cli.__main__ import app
from drivecal.cli.commands import campaigns
from drivecal.cli.commands.campaigns import counted
from drivecal.cli.commands.evaluate import difference_row
from drivecal.cli.commands.results import _print
from drivecal.cli.views import output, progress
from drivecal.cli.views.output import cells_text, duration, print_campaign, print_columns, saved, when
from drivecal.cli.views.progress import Bar, Lines
from drivecal.contracts.campaign import Baseline, Best, Campaign, CellCounts, ErrorRate, Progress, Seconds
from drivecal.contracts.evaluation import Difference
from drivecal.contracts.results import ImportanceAnswer, ParameterImportance
from drivecal.contracts.tables import ImportedRow
from drivecal.domain.scales import objective_text

CELLS = CellCounts(proposed=100, carried_over=40, requested=60, repeated=6, reused=9, simulated=44, failed=1, audited=2)
PREDICTED = CellCounts(proposed=100, requested=100, repeated=5, reused=5, predicted=40, simulated=50, sampled=8)


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.4, "0 s"), (59.4, "59 s"), (59.6, "1 min 00 s"), (185, "3 min 05 s"), (7800, "2 h 10 min")]
)
def test_durations_read_well(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_columns_align_numbers_right_and_text_left(capsys: pytest.CaptureFixture[str]) -> None:
    print_columns(["name", "share", "n"], [["a", "5.0 %", 1000], ["long name", "12.5 %", None]])
    assert capsys.readouterr().out == "name        share     n\na           5.0 %  1000\nlong name  12.5 %     -\n"


def test_results_from_elsewhere_show_curves(monkeypatch: pytest.MonkeyPatch) -> None:
    row = SimpleNamespace(**dict.fromkeys(ImportedRow.model_fields) | {"parameters": {"c1": 1.0, "c2": 2.0}})
    shape = SimpleNamespace(names=["c1", "c2"], values=lambda _: [1.0, 2.0])
    client = SimpleNamespace(imported=lambda *_: [row], problem=lambda _: SimpleNamespace(shapes={"g": shape}))
    monkeypatch.setattr(output, "connect", lambda _: nullcontext(client))
    printed = CliRunner().invoke(app, ["results", "list", "p"]).stdout
    assert ("g=[" in printed, "c2=" in printed) == (True, False)


@pytest.mark.parametrize("covered", [0.3, 0.8])
def test_what_matters_is_printed_first(monkeypatch: pytest.MonkeyPatch, covered: float) -> None:
    known = [("a", 0.1, 0.0, 0.3, 0.8), ("b", 0.8, 0.5, 0.9, 0.1), ("c", 0.0, 0.0, 0.01, 0.8), ("d", -0.1, 0.0, 0.01, 0.1)]
    items = [dict(zip(ParameterImportance.model_fields, each, strict=True)) for each in known]
    facts = {"scenario": "S1", "method": "", "sets": 50, "r2": 0.9, "items": items, "covered": covered}
    answer = ImportanceAnswer.model_validate(facts)
    client = SimpleNamespace(importance=lambda *_, scenario, variant: answer if (scenario, variant) == ("S1", "v") else None)
    monkeypatch.setattr(output, "connect", lambda _: nullcontext(client))
    lines = CliRunner().invoke(app, ["importance", "id", "--scenario", "S1", "--variant", "v"]).stdout.splitlines()
    said = [(line.split()[0], line.split()[-1]) for line in lines if line.startswith(("a ", "b ", "c ", "d "))]
    assert said == [("b", "matters"), ("a", "clear"), ("c", "little"), ("d", "clear")]
    assert ("sound" in lines[0]) == (covered == 0.8), "crowded sets tell nothing of the rest"


def test_a_rerun_may_have_another_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[object] = []
    client = SimpleNamespace(
        campaign=lambda _: SimpleNamespace(id="a", spec={"budget": {"minutes": 9}}), rerun=lambda *given: asked.extend(given)
    )
    monkeypatch.setattr(output, "connect", lambda _: nullcontext(client))
    monkeypatch.setattr(campaigns, "submitted", lambda *_: ({}, lambda: None))
    assert CliRunner().invoke(app, ["rerun", "a", "--budget", "60"]).exit_code == 0
    assert asked == ["a", {"budget": {"minutes": 9, "simulations": 60}, "weights": {}}]


def test_saved_is_the_share_that_needed_no_simulation() -> None:
    assert saved(CELLS) == pytest.approx(15 / 60)
    assert saved(CellCounts()) == 0
    assert saved(PREDICTED) == pytest.approx(50 / 100)


def test_the_cells_add_up_on_their_line() -> None:
    assert cells_text(CELLS) == (
        "60 requested = 44 simulated + 6 repeated + 9 reused + 1 failed; 40 more carried over from the iteration before"
    )


def test_a_campaign_shows_all_that_matters(capsys: pytest.CaptureFixture[str]) -> None:
    campaign = Campaign(
        id="0" * 32,
        name="mine",
        state="running",
        stage="calibration",
        iteration=2,
        degraded="1 of 2 workers is gone",
        progress=Progress(done=60, total=100, eta_seconds=61),
        stages={"calibration": CELLS},
        error_rate={"S1": ErrorRate(audited=20, different=2, wrong=1, upper_95=0.25), "S2": ErrorRate()},
        best=Best(objective=5.5, parameters={"P1": 0.5, "P2": 3}, scores={"S1": 5, "S2": 6}, alternatives=2, replicates=8),
        baseline=Baseline(objective=4.0, parameters={"P1": 0, "P2": 1}, scores={}, seeds=[13, 14], best_objective=4.5),
        seconds=Seconds(wall=90, simulating=100),
        notes=["not simulated because their weight is 0: S3"],
        budget={"simulations": 2000.0, "minutes": 0.5, "stagnation": None},
    )
    print_campaign(campaign)
    printed = capsys.readouterr().out
    for wanted in (
        "running, calibration, iteration 3, 60 of 100 cells, about 1 min 01 s left, degraded: 1 of 2 workers is gone",
        "5.5000  P1=0.5 P2=3",
        "4.0000 under 2 seeds (the best set under them: 4.5000)  P1=0 P2=1",
        "S1 5  S2 6",
        "0 started",
        "0 of 2,000 simulations, 0 of 0.5 min",
        "weight is 0: S3",
        "1 min 30 s since its start, pauses included; CPU time of the simulations 1 min 40 s",
    ):
        assert wanted in printed


def test_without_a_terminal_lines_are_few(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=iter([0.0, 1.0, 2.0, 7.5, 13.0, 14.0]).__next__))
    lines = Lines()
    running = Campaign(id="0" * 32, name="mine", state="running", stage="calibration", spec={"optimizer": {"iterations": 10}})
    lines.show(running.model_copy(update={"state": "queued", "stage": None}))
    for iteration in range(3):
        lines.show(
            running.model_copy(
                update={"iteration": iteration, "progress": Progress(done=5, total=10), "stages": {"calibration": CELLS}}
            )
        )
    broken = Best(objective=2e-5, parameters={}, scores={}, alternatives=1, violation=0.02)
    lines.show(running.model_copy(update={"iteration": 10, "stage": "calibration", "best": broken, "degraded": "slow"}))
    lines.show(running.model_copy(update={"state": "succeeded"}))
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.splitlines() == [
        "queued",
        "calibration 1/10  5/10 cells  simulated 44  repeated 6  reused 9  failed 1",
        "calibration 3/10  5/10 cells  simulated 44  repeated 6  reused 9  failed 1",
        "calibration, confirming  best 2e-05, breaks constraints by 2.0 %  degraded: slow",
        "succeeded",
    ]


@pytest.mark.parametrize(
    ("objective", "text"),
    [(6.25, "6.2500"), (0.0, "0.0000"), (-0.5, "-0.5000"), (2.14e-5, "2.14e-05"), (1234567.5, "1.23457e+06")],
)
def test_small_and_large_objectives_keep_their_digits(objective: float, text: str) -> None:
    assert objective_text(objective) == text


@pytest.mark.parametrize(
    ("given", "refused"),
    [
        (["submit", "c.yaml", "--timeout", "3"], "--timeout needs --wait"),
        (["submit", "c.yaml", "--dry-run", "--wait"], "leave --wait"),
        (["rerun", "abcd", "--weights", "S1=2", "--timeout", "3"], "--timeout needs --wait"),
        (["compare-optimizers", "--tag", "t", "--dry-run"], "--dry-run needs a FILE"),
        (["compare-optimizers", "c.yaml", "--timeout", "3"], "--timeout needs --wait"),
        (["validate", "abcd", "--predicted", "--references", "3"], "leave it out with --predicted"),
        (["export", "abcd", "--json", "--format", "csv"], "--json is --format json"),
        (["check", "abcd#1", "--names", "names.yaml"], "only DCM and CDFX files have labels"),
    ],
)
def test_an_option_without_effect_is_refused(given: list[str], refused: str) -> None:
    result = CliRunner().invoke(app, given, env={"COLUMNS": "200"})
    assert (result.exit_code, refused in result.stderr) == (2, True), result.stderr


@pytest.mark.parametrize(("there", "said"), [("outside", None), ("anywhere", "nowhere"), ("influential", "everywhere")])
def test_an_explanation_says_nothing_of_values_outside_the_map(there: str, said: str | None) -> None:
    known = {"parameter": "P1", "value": 9.0, "reference_value": 8.0, "lower": None, "upper": None, "blocks": True}
    difference = Difference.model_validate(known | {"region": "outside", "reference_region": there})
    assert difference_row(difference)[3] == said


def test_a_study_is_listed_with_the_cells_of_its_stages() -> None:
    study = Campaign(id="s", name="s", state="succeeded", stages={"robustness": CellCounts(requested=5417, simulated=5400)})
    assert (counted(study).requested, counted(study).simulated) == (5417, 5400)
    searched = study.model_copy(update={"stages": {**study.stages, "calibration": CELLS}})
    assert counted(searched) == CELLS


def test_version_and_usage() -> None:
    assert CliRunner().invoke(app, ["--version"]).stdout.startswith("drivecal 0.")
    unknown = CliRunner().invoke(app, ["nothing"])
    assert unknown.exit_code == 2
    assert "Traceback" not in unknown.output
    assert CliRunner().invoke(app, ["show"]).exit_code == 2
    assert CliRunner().invoke(app, ["list", "--limit", "0"]).exit_code == 2
    assert CliRunner().invoke(app, ["list", "--state", "odd"]).exit_code == 2


def test_the_bar_shows_outcomes_and_reasons_as_they_are() -> None:
    console = Console(file=io.StringIO(), force_terminal=True, color_system="truecolor", width=160)
    running = Campaign(id="0" * 32, name="mine", state="running", stage="calibration", stages={"calibration": PREDICTED})
    with RichProgress(TextColumn("{task.fields[detail]}"), console=console, auto_refresh=False) as progress:
        Bar(progress).show(running.model_copy(update={"degraded": "no worker [/opt/sim] agrees"}))
        progress.refresh()
    assert isinstance(console.file, io.StringIO)
    shown = console.file.getvalue()
    assert "no worker [/opt/sim] agrees" in shown
    assert "simulated 50" in shown


def test_a_moment_names_its_offset_because_an_hour_comes_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    try:
        first = datetime(2026, 10, 25, 0, 30, tzinfo=UTC)
        assert when(first) == "2026-10-25 02:30:00+02:00"
        assert when(first + timedelta(hours=1)) == "2026-10-25 02:30:00+01:00"
        assert when(None) == ""
    finally:
        monkeypatch.undo()
        time.tzset()


NAME = "a\x1b]0;owned\x07\x9b31m\u202egnp.exe\u00e9,1\r\n"
ENCODED = NAME.encode()


def test_a_terminal_gets_nothing_that_it_would_obey() -> None:
    terminal, side = os.openpty()
    with os.fdopen(side, "w") as stream:
        _print(iter(ENCODED[index : index + 1] for index in range(len(ENCODED))), stream)
        shown = os.read(terminal, 1000).decode()
    os.close(terminal)
    assert shown.rstrip() == "a\ufffd]0;owned\ufffd\ufffd31m\ufffdgnp.exe\u00e9,1"


def test_a_pipe_gets_the_file_as_it_is() -> None:
    stream = io.TextIOWrapper(io.BytesIO())
    _print(iter([ENCODED]), stream)
    stream.seek(0)
    assert stream.buffer.read() == ENCODED

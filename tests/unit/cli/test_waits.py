"""`--timeout` of commands that wait several times."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from drivecal.cli.commands import evaluate
from drivecal.cli.main import app
from drivecal.cli.views import progress


def test_an_evaluation_and_its_time_series_have_one_time_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    paused: list[float] = []
    answers = iter([SimpleNamespace(id="e", state=state) for state in ("running", "running", "succeeded")])
    client = SimpleNamespace(evaluate=lambda _: next(answers), evaluation=lambda _: next(answers), trace=lambda _: None)
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: sum(paused), sleep=paused.append))
    monkeypatch.setattr(evaluate, "connect", lambda _: nullcontext(client))
    given = ["evaluate", "x=1", "--scenario", "s", "--trace", str(tmp_path / "run.csv"), "--timeout", "0.8"]
    assert CliRunner().invoke(app, given).exit_code == 6
    assert sum(paused) < 1.2

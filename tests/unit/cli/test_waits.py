"""`--timeout` of commands that wait several times."""

import json
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from drivecal.cli.commands import check, evaluate
from drivecal.cli.main import app
from drivecal.cli.views import progress
from drivecal.contracts.evaluation import EvaluatedCell, Evaluation
from drivecal.contracts.inventory import ProblemAnswer


def made(model: Any, **fields: Any) -> Any:
    """Returns an answer with the fields that the commands read."""
    return model.model_construct(**fields)


class Slow:
    """A client whose server answers each request at the second question."""

    def __init__(self) -> None:
        self.questions = 0

    def problem(self, name: str) -> Any:
        scores: dict[str, Any] = {"cost": {}, "ease": {}}
        return made(ProblemAnswer, name=name, digest="d", parameters={}, scores=scores, measures={}, simulator={})

    def evaluate(self, _: object) -> Any:
        return made(Evaluation, id="e", state="running", items=[], unrepeatable=0)

    def evaluation(self, _: str) -> Any:
        self.questions += 1
        cell = made(EvaluatedCell, scenario="s", score=1.0, outcome="simulated")
        state = "running" if self.questions % 2 else "succeeded"
        return made(Evaluation, id="e", state=state, items=[cell], unrepeatable=0, error=None)

    def trace(self, _: str) -> None:
        self.questions += 1


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch) -> Slow:
    """The client of the commands, with a clock that only pauses move."""
    client, paused = Slow(), list[float]()
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: sum(paused), sleep=paused.append))
    for module in (check, evaluate):
        monkeypatch.setattr(module, "connect", lambda _: nullcontext(client))
    return client


def test_a_check_of_two_scores_ends_at_one_time_limit(slow: Slow, tmp_path: Path) -> None:
    (tmp_path / "set.json").write_text("{}")
    (tmp_path / "limits.json").write_text(json.dumps({"limits": [{"score": "ease", "at_least": 0}]}))
    given = ["check", str(tmp_path / "set.json"), "--limits", str(tmp_path / "limits.json"), "--timeout"]
    assert CliRunner().invoke(app, [*given, "0.8"]).exit_code == 6
    assert slow.questions == 3
    assert CliRunner().invoke(app, [*given, "2"]).exit_code == 0


def test_an_evaluation_and_its_time_series_have_one_time_limit(slow: Slow, tmp_path: Path) -> None:
    given = ["evaluate", "x=1", "--scenario", "s", "--trace", str(tmp_path / "run.csv"), "--timeout", "0.8"]
    assert CliRunner().invoke(app, given).exit_code == 6
    assert slow.questions == 4

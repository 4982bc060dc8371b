"""The check of a problem before its push rates as a campaign does."""

import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from drivecal.adapters.pipes import Pipes
from drivecal.bundles.archives import pack
from drivecal.bundles.checks import checked
from drivecal.local import evaluate
from drivecal.local.problems import CheckedScenario, doubtful_ranges, other_set, run_problem
from drivecal.plugins.simulators import BusyError

EXAMPLE = Path(__file__).parents[3] / "deploy" / "examples" / "problems" / "python-function"

LEAVING = """
import json, os, shutil, sys
print(json.dumps({"ready": bool(input())}), flush=True)
for number in (1, 2):
    json.loads(input())
    if number == 2:
        shutil.rmtree(os.getcwd())
    print(json.dumps({"id": number, "measures": {"y": 1.0}}), flush=True)
"""
"""A simulator that removes its working directory in its second run, and ends."""


ONCE = """
import json, os
input()
print(json.dumps({"error": "no licence"} if os.path.exists("../taken") else {"ready": True}), flush=True)
open("../taken", "w").close()
while "id" in (request := json.loads(input())):
    print(json.dumps({"id": request["id"], "measures": {"y": 1.0}}), flush=True)
"""
"""A simulator that starts only once."""
DOCUMENT: dict[str, Any] = {
    "problem": "leaving",
    "parameters": {"x": {"lower": 0, "upper": 1, "step": 0.5}},
    "scenarios": {"s": {}},
    "simulator": {"kind": "process", "command": [sys.executable, "sim.py"]},
    "measures": {"y": "m"},
    "scores": {"y": {"formula": "y", "direction": "minimise", "range": [0, 10]}},
}


def check(folder: Path, simulator: str) -> CheckedScenario:
    """The check of a problem with this simulator and a second set."""
    folder.mkdir(exist_ok=True)
    (folder / "problem.yaml").write_text(yaml.safe_dump(DOCUMENT))
    (folder / "sim.py").write_text(simulator)
    [result] = run_problem(checked(DOCUMENT), pack(folder), {"x": 0.5}, {"x": 1.0})
    return result


@pytest.mark.parametrize(("constraints", "other"), [([], {"x": "early"}), (["x != 'early'"], None)])
def test_the_other_set_of_a_check_is_another_one(constraints: list[str], other: dict[str, str] | None) -> None:
    document = DOCUMENT | {"parameters": {"x": {"choices": ["early", "late"]}}, "baseline": {"x": "late"}}
    assert other_set(checked(document | {"constraints": constraints})) == other


def test_a_simulator_that_removes_its_folder_is_named_by_the_check(tmp_path: Path) -> None:
    result = check(tmp_path, LEAVING)
    assert result.other is not None
    assert result.other.error


def test_a_simulator_that_does_not_start_again_is_named_by_the_check(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Pipes, "is_fresh", lambda _: False)  # each run has a new child
    (folder := tmp_path / "elsewhere").mkdir()
    monkeypatch.setenv("DRIVECAL_SIMULATOR_FOLDERS", str(folder))
    once = ONCE.replace('"../taken"', repr(str(folder / "taken")))
    assert "no licence" in (check(tmp_path, once).error or "")


def test_an_evaluation_names_why_its_simulator_is_busy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRIVECAL_BUNDLE_CACHE", str(tmp_path / "cache"))
    check(folder := tmp_path.joinpath("problem"), """input(), print('{"busy": "no licence"}', flush=True), input()""")
    with pytest.raises(BusyError, match="no licence"):
        evaluate({"x": 0.5}, problem=folder)


@pytest.mark.parametrize(
    ("scores", "span", "doubtful"),
    [
        ((32.5, 62.5), (0, 100), False),
        ((32.5, 62.5), (0, 10), True),
        ((32.5, 62.5), (50, 60), False),  # around it
        ((32.5, 62.5), (0, 100_000), True),
        ((3.0, 3.0), (0, 100_000), False),  # one value says nothing about its spread
    ],
)
def test_a_range_far_from_scores_is_doubtful(scores: tuple[float, float], span: tuple[float, float], *, doubtful: bool) -> None:
    manifest = checked(DOCUMENT | {"scores": {"y": {"formula": "y", "direction": "minimise", "range": span}}})
    runs = [CheckedScenario(scenario=name, scores={"y": score}) for name, score in zip(("a", "b"), scores, strict=True)]
    assert bool(doubtful_ranges(manifest, runs)) is doubtful

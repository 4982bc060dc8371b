"""Evaluation in process gives what a worker gives."""

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.support.values import faults_of

from drivecal import local
from drivecal.client.problem_templates import write_problem
from drivecal.configuration.problems import read_bundle
from drivecal.local.problems import run_problem

EXAMPLE = Path(__file__).parents[3] / "deploy" / "examples" / "problems" / "python-function"
BRAKE: dict[str, float | str] = {"trigger_ttc": 1.6, "deceleration": 7, "jerk": 30, "confirmations": 2, "warning": "sound"}
GOLDEN = Path(__file__).parents[2] / "golden" / "cells.json"
VALUES = [-14.5, 0.06, 182, 235, 132, 0.77, 124, 1486, 5.9, 8.3, 87]
HASTY = {f"P{number}": value for number, value in enumerate(VALUES, start=1)}


def golden() -> dict[str, Any]:
    cells: dict[str, Any] = json.loads(GOLDEN.read_text())["cells"]
    return {name.split()[0]: cell for name, cell in cells.items() if name.endswith("hasty")}


def test_all_scenarios_give_the_golden_cells() -> None:
    result = local.evaluate(HASTY)
    cells = golden()
    assert list(result.cells) == list(cells)
    for scenario, cell in result.cells.items():
        expected = cells[scenario]
        assert (cell.score, cell.failure, cell.error) == (expected["score"], expected["failure"], None)
        floats = {"rating": cell.rating, **cell.metrics}
        for name, value in expected["floats"].items():
            assert floats[name] == pytest.approx(float.fromhex(value), rel=2e-6, abs=2e-6)  # of another processor, maybe
    assert result.objective == pytest.approx(sum(cell["score"] for cell in cells.values()) / len(cells))


def test_no_scenarios_have_no_objective() -> None:
    assert local.evaluate(HASTY, []).objective is None


def test_the_named_scenarios_are_simulated_with_the_given_vehicle() -> None:
    result = local.evaluate(HASTY, ["S4", "S2"], vehicle={"model": "single_track", "parameters": {"mass": 2500}})
    assert list(result.scores) == ["S4", "S2"]
    assert result.cells["S4"].metrics != local.evaluate(HASTY, "S4").cells["S4"].metrics


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"parameters": {"P1": 1.0}}, "parameters"),
        ({"scenarios": "S9"}, "scenario"),
        ({"evaluator": "nothing"}, "evaluator"),
        ({"vehicle": {"modle": "x"}}, "vehicle"),
    ],
)
def test_wrong_arguments_are_refused_by_their_field(arguments: dict[str, Any], field: str) -> None:
    assert any(problem.field.startswith(field) for problem in faults_of(local.evaluate, **{"parameters": HASTY} | arguments))


def test_a_problem_is_simulated_and_rated_as_by_its_check(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRIVECAL_BUNDLE_CACHE", str(tmp_path / "cache"))
    manifest, archive = read_bundle(EXAMPLE)
    checked = {result.scenario: result for result in run_problem(manifest, archive, BRAKE)}
    for score in ("discomfort", "safety"):
        result = local.evaluate(BRAKE, problem=EXAMPLE, evaluator=score)
        assert result.scores == {name: checked[name].scores[score] for name in manifest.scenarios}
        assert {name: dict(cell.metrics) for name, cell in result.cells.items()} == {
            name: dict(each.measures) for name, each in checked.items()
        }
    assert local.evaluate(BRAKE, "wet", problem=EXAMPLE).scores == {"wet": checked["wet"].scores["discomfort"]}
    assert "<td>wet</td>" in local.evaluate(BRAKE, "wet", problem=EXAMPLE)._repr_html_()


def test_a_changed_file_is_another_simulation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRIVECAL_BUNDLE_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "mine"
    write_problem("python", "mine", folder)
    (folder / "model.py").write_text('def evaluate(parameters, scenario):\n    return {"failure": "overrun", "measures": {}}\n')
    parameters = dict(read_bundle(folder)[0].start or {})
    assert {cell.failure for cell in local.evaluate(parameters, problem=folder).cells.values()} == {"overrun"}
    (folder / "model.py").write_text("def evaluate(parameters, scenario):\n    raise KeyError('gap')\n")
    cells = local.evaluate(parameters, problem=folder).cells.values()
    assert {cell.score for cell in cells} == {None}
    assert all(cell.error is not None and "gap" in cell.error for cell in cells)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"parameters": BRAKE | {"jerk": 5000}}, "parameters.jerk"),
        ({"scenarios": "dry"}, "scenario"),
        ({"evaluator": "x"}, "evaluator"),
    ],
)
def test_wrong_arguments_of_a_problem_are_refused_by_their_field(arguments: dict[str, Any], field: str) -> None:
    given: dict[str, Any] = {"parameters": BRAKE, "problem": EXAMPLE}
    assert any(problem.field.startswith(field) for problem in faults_of(local.evaluate, **given | arguments))


def test_a_copy_of_the_motorway_gives_its_bits(tmp_path: Path) -> None:
    write_problem("highway-planner", "mine", tmp_path / "mine")
    with (tmp_path / "mine" / "problem.yaml").open("a") as file:
        file.write("  felt: {evaluator: learned, direction: maximise, range: [0, 10]}\n")
    manifest, archive = read_bundle(tmp_path / "mine")
    assert manifest.problem == "mine"
    checked = next(iter(run_problem(manifest, archive, HASTY)))
    assert local.evaluate(HASTY, "S1", problem=tmp_path / "mine", evaluator="felt").scores == {"S1": checked.scores["felt"]}
    copied, original = (local.evaluate(HASTY, ["S1", "S4"], problem=problem).cells for problem in (tmp_path / "mine", None))
    for name, cell in original.items():
        assert (copied[name].rating, copied[name].metrics) == (cell.rating, cell.metrics)


def test_varied_parameters_come_among_the_parameters_and_may_be_changed(tmp_path: Path) -> None:
    document = yaml.safe_load((EXAMPLE / "problem.yaml").read_text())
    folder = tmp_path / "slope"
    folder.mkdir()
    document |= {
        "problem": "slope",
        "parameters": {"gain": {"lower": 0, "upper": 1}},
        "varied": {"slope": {"nominal": 0, "lower": -0.1, "upper": 0.1, "unit": "rad"}},
        "constraints": [],
        "baseline": None,
        "simulator": {"kind": "python", "file": "model.py", "deterministic": True},
        "scenarios": {"hill": {}},
        "measures": {"error": "1"},
        "scores": {"error": {"formula": "error", "direction": "minimise", "range": [0, 2]}},
    }
    (folder / "problem.yaml").write_text(yaml.safe_dump(document))
    (folder / "model.py").write_text(
        "def evaluate(parameters, scenario):\n    return {'error': abs(parameters['gain'] - 10 * parameters['slope'])}\n"
    )
    manifest, archive = read_bundle(folder)
    (checked,) = run_problem(manifest, archive, {"gain": 0.5})
    assert checked.measures == {"error": 0.5}
    varied = {"parameters": {"slope": 0.05}}
    scores = [local.evaluate({"gain": 0.5}, problem=folder, vehicle=vehicle).scores for vehicle in ({}, varied)]
    assert scores == [{"hill": 0.5}, {"hill": 0.0}]
    for wrong in ({"parameters": {"mass": 1}}, {"model": "hybrid"}):
        assert faults_of(local.evaluate, {"gain": 0.5}, problem=folder, vehicle=wrong)[0].field.startswith("vehicle.")

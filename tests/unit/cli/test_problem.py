"""`drivecal problem check`: what a user learns of a problem before any server sees it."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.support.command import command

from drivecal.contracts.strict_yaml import located_yaml

MANIFEST = """
problem: acc
parameters:
  x: {lower: 0, upper: 1}
  n: {lower: 1, upper: 8, integer: true}
  g: {lower: 0.1, upper: 0.7, step: 0.2}
  mode: {choices: [eco, sport]}
simulator: {kind: python, file: model.py, deterministic: DETERMINISTIC}
scenarios: {city: {gap: 30}, road: {gap: 60}}
measures: {energy: kWh}
failures: [collision]
scores:
  cost: {formula: "10/energy", direction: minimise, range: [0, 10]}
"""
GOOD = "def evaluate(p, s):\n    return {'energy': p['x'] * p['n'] + s['gap']}\n"
Write = Callable[..., str]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Writes a problem and returns its folder."""

    def made(model: str = GOOD, manifest: str = MANIFEST, *, deterministic: bool = True) -> str:
        (tmp_path / "problem.yaml").write_text(manifest.replace("DETERMINISTIC", str(deterministic).lower()))
        (tmp_path / "model.py").write_text(model)
        return str(tmp_path)

    return made


def check(folder: str, *options: str) -> tuple[int, dict[str, Any]]:
    result = command("problem", "check", folder, "--json", *options)
    return result.exit_code, json.loads(result.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["process", "command", "python"])
def test_a_new_problem_works_as_it_is(tmp_path: Path, kind: str) -> None:
    folder = str(tmp_path / "mine")
    made = command("problem", "init", kind, "mine", "--folder", folder, "--json")
    assert made.exit_code == 0, made.stderr
    assert f"{folder}/problem.yaml" in json.loads(made.stdout)["files"]
    code, report = check(folder)
    assert (code, report["name"]) == (0, "mine")
    needs_a_new_process = None if kind == "command" else True
    assert {scenario["other"]["alone"] for scenario in report["scenarios"]} == {needs_a_new_process}
    assert command("problem", "init", kind, "mine", "--folder", folder).exit_code == 2, "nothing is overwritten"


def test_an_unknown_kind_is_a_wrong_use(tmp_path: Path) -> None:
    assert command("problem", "init", "magic", "mine", "--folder", str(tmp_path / "mine")).exit_code == 2
    assert not (tmp_path / "mine").exists()


def test_every_scenario_is_run_twice_in_the_middle_of_the_space_on_its_grid(write: Write) -> None:
    code, report = check(write())
    assert code == 0
    assert report["parameters"] == {"x": 0.5, "n": 4, "g": 0.3, "mode": "sport"}
    city, road = report["scenarios"]
    assert (city["scenario"], city["measures"], city["scores"]) == ("city", {"energy": 32.0}, {"cost": 10 / 32})
    assert (city["repeats"], len(city["seconds"]), city["error"]) == (True, 2, None)
    assert road["measures"] == {"energy": 62.0}
    assert [scenario["other"]["alone"] for scenario in report["scenarios"]] == [True, True]
    assert (len(report["digest"]), report["files"]) == (64, ["model.py", "problem.yaml"])


@pytest.mark.slow
def test_another_set_within_the_constraints_is_tried_too(write: Write) -> None:
    manifest = MANIFEST + 'constraints: ["x > 0.9", "n < 3"]\nbaseline: {x: 0.95, n: 2, g: 0.3, mode: eco}\n'
    code, report = check(write(manifest=manifest))
    other = report["other_parameters"]
    assert code == 0
    assert (other["x"] > 0.9, other["n"] < 3, other["g"] in {0.1, 0.3, 0.5, 0.7}) == (True, True, True)
    assert other != report["parameters"]
    assert [scenario["other"]["measures"]["energy"] for scenario in report["scenarios"]] == pytest.approx(
        [other["x"] * other["n"] + gap for gap in (30, 60)]
    )
    assert check(write(manifest=manifest))[1]["other_parameters"] == other
    assert f"x={other['x']:g}" in command("problem", "check", write(manifest=manifest)).stdout


def test_another_set_without_a_result_is_a_warning(write: Write) -> None:
    code, report = check(write("def evaluate(p, s):\n    assert p['x'] == 0.5, 'no mesh'\n    return {'energy': 1.0}\n"))
    assert (code, len(report["warnings"])) == (0, 2)
    assert all("no mesh" in scenario["other"]["error"] for scenario in report["scenarios"])


KEEPS = "first = None\ndef evaluate(p, s):\n    global first\n    first = first or p['x']\n    return {'energy': 1.0 + first}\n"
"""Answers by the first set that its process got."""


@pytest.mark.slow
def test_state_kept_from_the_first_run_is_a_warning(write: Write) -> None:
    code, report = check(write(KEEPS))
    assert (code, [scenario["repeats"] for scenario in report["scenarios"]]) == (0, [True, True])
    assert [scenario["other"]["alone"] for scenario in report["scenarios"]] == [False, False]
    assert [warning.split(":")[0] for warning in report["warnings"]] == ["city", "road"]
    assert all("new process" in warning for warning in report["warnings"])
    unclaimed = check(write(KEEPS, deterministic=False))[1]
    assert ([scenario["other"]["alone"] for scenario in unclaimed["scenarios"]], unclaimed["warnings"]) == ([None, None], [])


def test_a_set_that_has_a_result_after_others_only_is_a_warning(write: Write) -> None:
    model = "known = set()\ndef evaluate(p, s):\n    known.add(p['x'])\n    assert 0.5 in known, 'no start'\n    return {'energy': 1.0}\n"
    code, report = check(write(model))
    assert (code, len(report["warnings"])) == (0, 2)
    assert all("no start" in scenario["other"]["alone_error"] for scenario in report["scenarios"])


def test_the_table_shows_scores_measures_and_times(write: Write) -> None:
    result = command("problem", "check", write())
    assert result.exit_code == 0
    assert {"scenario", "cost", "energy", "wall"} <= set(result.stdout.split())


@pytest.mark.slow
def test_curves_are_tried_and_printed_as_lists(write: Write) -> None:
    curve = "  gain: {curve: {axis: [0, 1, 2]}, lower: 1, upper: 1.5, coefficients: 2}\nsimulator"
    folder = write("def evaluate(p, s):\n    return {'energy': sum(p['gain'])}\n", MANIFEST.replace("simulator", curve))
    assert check(folder)[1]["parameters"]["gain"] == [1.25, 1.25, 1.25]
    assert "gain=[1.25, 1.25, 1.25]" in command("problem", "check", folder).stdout


def test_different_bits_are_told_and_fail_where_the_simulator_claims_to_be_deterministic(write: Write) -> None:
    noisy = "import itertools\nnumbers = itertools.count()\ndef evaluate(p, s):\n    return {'energy': 1.0 + next(numbers)}\n"
    code, report = check(write(noisy, deterministic=False))
    assert (code, [scenario["repeats"] for scenario in report["scenarios"]]) == (0, [False, False])
    assert check(write(noisy))[0] == 1


def test_the_problem_of_the_readme_works_as_it_is_shown(tmp_path: Path) -> None:
    text = (Path(__file__).parents[3] / "README.md").read_text()
    shown = re.findall(r'^```[a-z]+ title="my-stop/(.*?)"\n(.*?)^```', text, re.MULTILINE | re.DOTALL)
    assert {name for name, _ in shown} == {"brake.py", "problem.yaml"}
    for name, content in shown:
        (tmp_path / name).write_text(content)
    code, report = check(str(tmp_path))
    assert (code, report["warnings"]) == (0, [])
    assert [scenario["failure"] for scenario in report["scenarios"]] == [None, None]


def test_a_score_that_is_cut_off_is_a_warning_with_its_true_value(write: Write) -> None:
    model = "def evaluate(p, s):\n    return {'energy': 10 / (14.5 if p['x'] == 0.5 else 4.5)}\n"
    code, report = check(write(model))
    assert (code, [scenario["scores"]["cost"] for scenario in report["scenarios"]]) == (0, [10.0, 10.0])
    cut = [warning for warning in report["warnings"] if "`failed`" in warning]
    assert [(warning.split(":")[0], "14.5" in warning) for warning in cut] == [("city", True), ("road", True)]
    assert check(write(model, MANIFEST.replace("[0, 10]", "[0, 10], failed: 20")))[1]["warnings"] == []


def test_a_failure_and_a_score_without_a_value_are_worth_the_worst(write: Write) -> None:
    code, report = check(write("def evaluate(p, s):\n    return {'energy': 0.0}\n"))
    assert (code, report["scenarios"][0]["scores"]) == (0, {"cost": 10.0})
    assert "cost" in report["scenarios"][0]["undefined"]


def test_a_run_without_a_result_fails_with_its_reason(write: Write) -> None:
    folder = write("def evaluate(p, s):\n    raise ValueError('no licence')\n")
    code, report = check(folder)
    assert (code, command("problem", "check", folder).stderr.count("no licence")) == (1, 1)
    assert "no licence" in report["scenarios"][0]["error"]
    assert report["other_parameters"] is None, "it was not run"


def test_a_hang_is_named_with_its_limit_before_and_at_its_end(write: Write) -> None:
    manifest = MANIFEST.replace("DETERMINISTIC}", "DETERMINISTIC, timeout: 2}").replace(", road: {gap: 60}", "")
    folder = write("import time\ndef evaluate(p, s):\n    time.sleep(600)\n", manifest)
    result = command("problem", "check", folder, "--json")
    assert "2 s (`simulator.timeout` in problem.yaml)" in result.stderr
    (scenario,) = json.loads(result.stdout)["scenarios"]
    assert (result.exit_code, "`simulator.timeout` in problem.yaml" in scenario["error"]) == (1, True)


def test_a_faulty_manifest_is_refused_with_its_line(write: Write) -> None:
    result = command("problem", "check", write(manifest=MANIFEST.replace("10/energy", "10/power")))
    assert result.exit_code == 2
    assert "line 13" in result.stderr
    assert command("problem", "check", "/nowhere").exit_code == 2


def test_a_middle_that_breaks_a_constraint_asks_for_a_baseline(write: Write) -> None:
    manifest = MANIFEST + 'constraints: ["x > 0.9"]\n'
    assert command("problem", "check", write(manifest=manifest)).exit_code == 2
    code, report = check(write(manifest=manifest + "baseline: {x: 0.95, n: 2, g: 0.3, mode: eco}\n"))
    assert (code, report["parameters"]) == (0, {"x": 0.95, "n": 2, "g": 0.3, "mode": "eco"})


def test_a_range_far_from_the_measured_scores_is_told_with_their_values(write: Write) -> None:
    code, report = check(write(manifest=MANIFEST.replace('"10/energy"', '"energy"')))
    [doubtful] = [warning for warning in report["warnings"] if "scores.cost.range" in warning]
    assert (code, "32 to 62" in doubtful) == (0, True)


def test_printed_sections_can_be_read_back_whatever_a_parameter_is_called(tmp_path: Path) -> None:
    (tmp_path / "set.dcm").write_text("KONSERVIERUNG_FORMAT 2.0\nFESTWERT null\n WERT 1\nEND\n")
    document: Any = located_yaml(command("parameters", str(tmp_path / "set.dcm")).stdout.encode())[0]
    assert document["parameters"].keys() == document["baseline"].keys() == {"null"}

"""`drivecal check`: exit status, JUnit, summary, and what it simulates."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import typer
import yaml
from scipy import stats
from tests.support.computed import ComputedBackend
from tests.support.problems import MANIFEST, heated, push
from tests.support.runs import working
from tests.support.server import RunningApi, serving
from tests.support.tree import PROJECT
from typer.testing import CliRunner, Result

from drivecal.cli.__main__ import app
from drivecal.client import Client
from drivecal.contracts.work import Cell, CellResult, SetupRequest

BASELINE = {f"P{number}": 0.5 for number in range(1, 12)}
MEASURE = "peak_lateral_acceleration_mps2"


def answered(scenario: str, cell: Cell) -> CellResult:
    rating = 6.0 * float(cell.parameters["P1"]) + int(scenario[1:]) / 10
    return CellResult(cell.id, rating, round(rating), {MEASURE: rating}, None, 7.0)


@dataclass
class Checking:
    api: RunningApi
    backend: ComputedBackend
    folder: Path

    def file(self, name: str, content: Any) -> str:
        path = self.folder / name
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return str(path)

    def __call__(self, *arguments: str) -> Result:
        return CliRunner().invoke(app, ["check", *arguments, "--url", self.api.url])


@pytest.fixture
def checking(tmp_path: Path) -> Iterator[Checking]:
    backend = ComputedBackend(answer=answered)
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}") as api, working(api.database, backend):
        yield Checking(api, backend, tmp_path)


def test_a_set_is_checked_against_limits_and_baseline_in_every_scenario(checking: Checking) -> None:
    chosen = checking.file("set.json", BASELINE | {"P1": 0.4, "other": 1})
    limits = checking.file(
        "limits.yaml",
        {
            "limits": [
                {"score": "comfort", "at_least": 2},
                {"measure": MEASURE, "at_most": 2.7, "scenarios": ["S1", "S4"]},
                {"score": "comfort", "worse_by_at_most": 0.5},
            ]
        },
    )
    baseline = checking.file("base.yaml", {"parameters": BASELINE})
    junit, summary = checking.folder / "junit.xml", checking.folder / "summary.md"
    failed = checking(
        chosen, "--limits", limits, "--baseline", baseline, "--junit", str(junit), "--summary", str(summary), "--json"
    )
    assert failed.exit_code == 1, failed.output
    document = json.loads(failed.stdout)
    broken = {(each["scenario"], each["limit"]) for each in document["findings"] if each["broken"]}
    [both, _] = [each["broken"] for each in document["findings"] if each["broken"] and "worse" in each["limit"]]
    assert len(re.findall(r"\d", both)) == 2  # the set's score, and the baseline's
    worse = "comfort at most 0.5 worse than the baseline"
    assert broken == {("S4", f"{MEASURE} at most 2.7"), *((name, worse) for name in ("S5", "S6"))}
    suite = ET.fromstring(junit.read_bytes())
    assert (
        (int(suite.attrib["tests"]), int(suite.attrib["failures"]))
        == (len(document["findings"]), len(broken))
        == (20, len(broken))
    )
    assert len(suite.findall("testcase/failure")) == 3
    assert summary.read_text().count("\n| S") == 6
    assert [line.partition(":")[0] for line in summary.read_text().splitlines() if " at most " in line and line[0] == "S"] == [
        "S4",
        "S5",
        "S6",
    ]
    assert len(checking.backend.sent) == 12
    good = checking(baseline, "--limits", checking.file("few.yaml", {"limits": [{"score": "comfort", "at_least": 2}]}))
    assert good.exit_code == 0, good.output
    assert len(checking.backend.sent) == 12
    assert checking(baseline, "--fresh").exit_code == 0
    assert len(checking.backend.sent) == 18
    assert checking(chosen, "--seeds", "2").exit_code == 2, "its simulator is deterministic"


def test_new_runs_that_differ_from_stored_ones_fail_the_check(checking: Checking) -> None:
    chosen = checking.file("set.json", BASELINE)
    assert checking(chosen).exit_code == 0
    checking.backend.answer = lambda _, cell: CellResult(cell.id, 1.0, 1, {MEASURE: 9.0}, None, 7.0)
    assert checking(chosen).exit_code == 0
    again = checking(chosen, "--fresh", "--json")
    assert again.exit_code == 1
    assert [each["scenario"] for each in json.loads(again.stdout)["findings"] if each["broken"]] == ["all"]


@pytest.mark.slow
def test_a_fresh_check_takes_every_score_and_measure_from_new_runs(checking: Checking) -> None:
    push(checking.api.database, checking.folder / "heater")
    chosen, base = (checking.file(f"{gain}.json", MANIFEST["baseline"] | {"gain": gain}) for gain in (0.5, 1.0))
    bounds = [
        {"measure": "discomfort", "at_least": 8},
        {"score": "ease", "at_most": 2},
        {"score": "ease", "worse_by_at_most": 0.0},
    ]
    options = "--problem", "heater", "--limits", checking.file("limits.yaml", {"limits": bounds}), "--baseline", base, "--json"
    checking.backend.answer = heated
    assert {each["limit"] for each in broken(checking(chosen, *options))} >= {"ease at most 2"}
    values = {"energy_kwh": 1.0, "discomfort": 9.0}
    checking.backend.answer = lambda _, cell: CellResult(cell.id, None, None, values, None, 7.0)
    assert broken(checking(chosen, *options, "--fresh")) == [], "the problem does not say that its runs repeat"


def searched(checking: Checking, **changes: Any) -> str:
    document = {"optimizer": {"kind": "random", "population": 6, "iterations": 1, "seed": 1}, "reduction": {"mode": "off"}}
    with Client(checking.api.url) as client:
        return client.wait(client.submit(document | changes).id).id


def test_a_set_of_a_campaign_is_checked_in_its_scenarios_and_its_vehicle_without_simulations(checking: Checking) -> None:
    limited = checking.file("limits.json", {"limits": [{"score": "reference", "at_least": -9, "scenarios": ["S2"]}]})
    fixed = {f"P{number}": 0.25 for number in range(2, 12)}
    space = [{"name": "P1", "lower": 0, "upper": 1, "step": 0.1}]
    settings = {"vehicle": {"parameters": {"mass": 2500}}, "parameters": space, "fixed": fixed, "evaluator": "learned"}
    campaign = searched(checking, catalogue=["S1", "S3"], weights={"S1": 3}, **settings)
    before = len(checking.backend.sent)
    checked = json.loads(checking(f"{campaign}#1", "--baseline", f"{campaign}#2", "--json").stdout)
    with Client(checking.api.url) as client:
        best, second = (each.objective for each in client.solutions(campaign, limit=2).items)
    assert [checked[name] for name in ("objective", "baseline", "gain")] == pytest.approx([best, second, best - second])
    assert len(checking.backend.sent) == before
    assert checking(f"{campaign}#1", "--limits", limited).exit_code == 2


def test_the_constraints_of_a_campaign_are_limits_of_its_sets(checking: Checking) -> None:
    each, one = {"measure": MEASURE, "at_least": 7}, {"score": "comfort", "at_most": 6, "scenarios": ["S3"]}
    mean = {"name": "usual", "measure": MEASURE, "aggregate": "mean", "at_least": 1}
    settings = {"optimizer": {"kind": "surrogate"}, "budget": {"simulations": 24}, "weights": {"S2": 0}}
    campaign = searched(checking, catalogue=["S1", "S2", "S3"], constraints=[each | {"failed": 7}, one, mean], **settings)
    checked = json.loads(checking(f"{campaign}#1", "--json").stdout)
    broken = {(finding["scenario"], finding["limit"]): finding["broken"] for finding in checked["findings"]}
    assert {name for (name, limit), why in broken.items() if why is not None and limit.startswith(MEASURE)} == {"S1", "S3"}
    assert broken["S3", "comfort at most 6"] is None
    assert len(broken) == 6, "in S2, whose weight is 0, a result alone is wanted"
    assert [note for note in checked["notes"] if note.endswith(": usual")]


def test_the_best_set_of_a_variant_is_checked_in_its_scenarios_and_its_vehicle(checking: Checking) -> None:
    def opposed(scenario: str, cell: Cell) -> CellResult:
        share = float(cell.parameters["P1"])
        rating = 3 * (1 - share) if scenario == "S3" else 6 * share
        return CellResult(cell.id, rating, round(rating), {}, None, 7.0)

    checking.backend.answer, heavy = opposed, {"vehicle": {"parameters": {"mass": 2500}}}
    variants = {"one": heavy | {"scenarios": ["S3"]}, "both": heavy}
    campaign = searched(checking, catalogue=["S1", "S2", "S3"], weights={"S1": 1, "S2": 0, "S3": 1}, variants=variants)
    before = len(checking.backend.sent)
    for name in variants:
        with Client(checking.api.url) as client:
            [best] = client.solutions(campaign, limit=1, variant=name).items
        shown = json.loads(checking(f"{campaign}#1", "--variant", name, "--problem", "highway", "--json").stdout)["scenarios"]
        assert {f"{row['scenario']}@one": row["score"] for row in shown} == best.scores
    assert len(checking.backend.sent) == before
    assert checking(f"{campaign}#1", "--vehicle-parameters", "mass=2500").exit_code == 0
    assert len(checking.backend.sent) == before + 1, "S2 alone is in no variant"
    assert {checking(chosen, "--variant", "light").exit_code for chosen in (f"{campaign}#1", "set.json")} == {2}


def test_scores_are_checked_by_name_and_a_campaigns_own_comes_first(checking: Checking) -> None:
    scores = dict(zip(("cost", "reference"), MANIFEST["scores"].values(), strict=True))
    push(checking.api.database, checking.folder / "heater", scores=scores)
    checking.backend.answer = lambda _, cell: CellResult(cell.id, None, None, {"energy_kwh": 1.0, "discomfort": 3.0}, None, 7.0)
    campaign = searched(checking, problem="heater", evaluator="reference", objectives=[{"score": "cost"}])
    for chosen, score in ((checking.file("set.json", MANIFEST["baseline"]), 25), (f"{campaign}#1", 7)):
        shown = json.loads(checking(chosen, "--problem", "heater", "--json").stdout)["scenarios"]
        assert {each["score"] for each in shown} == {score}
    beside = json.loads(checking(f"{campaign}#1", "--baseline", "campaign", "--json").stdout)["beside_baseline"]
    assert (list(beside), beside["cost"]["gain"]) == (["reference", "cost"], 0), "each objective is compared"


@pytest.mark.slow
def test_a_set_of_a_random_problem_is_checked_by_the_runs_that_report_it(checking: Checking) -> None:
    def noisy(setup: SetupRequest, cell: Cell) -> CellResult:
        noise = (setup.seed * 7 % 11, setup.seed % 2)
        values = {"energy_kwh": 1 + 0.2 * noise[0], "discomfort": 1 + 0.1 * float(cell.parameters["gain"]) + 0.1 * noise[1]}
        return CellResult(cell.id, None, None, values, None, 7.0)

    push(checking.api.database, checking.folder / "heater", simulator=MANIFEST["simulator"] | {"random": True})
    checking.backend.driven = noisy
    campaign = searched(checking, problem="heater", budget={"simulations": 60})
    sent = len(checking.backend.sent)
    with Client(checking.api.url) as client:
        best = client.solutions(campaign, limit=1).items[0]
    document = json.loads(checking(f"{campaign}#1", "--json").stdout)
    assert len(best.seeds) > 2
    once = json.loads(checking(f"{campaign}#1", "--seeds", "1", "--json").stdout)
    assert (len(document["notes"]), len(once["notes"])) == (0, 1)
    assert {each["scenario"]: each["score"] for each in document["scenarios"]} == pytest.approx(best.scores)
    assert len(checking.backend.sent) == sent
    bounds = [
        {"measure": "energy_kwh", "at_most": 4},
        {"measure": "energy_kwh", "at_most": 2.1},
        {"measure": "energy_kwh", "at_least": 3},
        {"score": "cost", "worse_by_at_most": 0.5},
        {"rate": 0.6},
        {"rate": 0.01},
    ]
    options = "--seeds", "8", "--limits", checking.file("limits.json", {"limits": bounds})
    other = checking.file("other.json", best.parameters | {"gain": min(2.0, float(best.parameters["gain"]) + 0.01)})
    checked = json.loads(checking(f"{campaign}#1", *options, "--baseline", other, "--json").stdout)
    first = min(best.seeds)
    discomfort = 1 + 0.1 * float(best.parameters["gain"])
    costs = [10 * (1 + 0.2 * (seed * 7 % 11)) + 5 * (discomfort + 0.1 * (seed % 2)) for seed in range(first, first + 8)]
    within = stats.t.interval(0.95, 7, np.mean(costs), stats.sem(costs))
    assert [checked["scenarios"][0][end] for end in ("lower", "upper")] == pytest.approx(within)
    verdicts = {each["limit"]: (each["broken"] is not None, each["unsure"]) for each in checked["findings"]}
    kept, unsure = (False, False), (True, True)
    assert list(verdicts.values()) == [kept, kept, unsure, (True, False), kept, kept, unsure]
    assert checked["gain"] == pytest.approx(checked["baseline"] - checked["objective"])  # a cost
    assert checked["gain_lower"] == pytest.approx(checked["gain_upper"]), "seeds do the same to both"
    assert [(each["failures"], each["runs"]) for each in checked["scenarios"]] == [(0, 8)] * len(checked["scenarios"])
    assert "by equal seeds" in checking(f"{campaign}#1", *options, "--baseline", "campaign").stdout


def broken(checked: Result) -> list[dict[str, Any]]:
    return [each for each in json.loads(checked.stdout)["findings"] if each["broken"]]


def test_a_calibration_file_with_labels_is_checked_like_any_set(checking: Checking) -> None:
    lines = [f'FESTWERT ACC_{name}\n  EINHEIT_W "1"\n  WERT {value}\nEND\n' for name, value in (BASELINE | {"X": 3}).items()]
    file = checking.file("set.dcm", "KONSERVIERUNG_FORMAT 2.0\n" + "\n".join(lines))
    names = checking.file("names.yaml", {name: f"ACC_{name}" for name in BASELINE})
    assert checking(file, "--names", names).exit_code == 0
    missing = checking(file)
    assert missing.exit_code == 2
    assert "parameters.P1" in missing.output
    endless = checking(checking.file("inf.dcm", Path(file).read_text().replace("WERT 0.5", "WERT inf", 1)), "--names", names)
    assert endless.exit_code == 2
    assert "inf.dcm, line 4" in endless.output


def test_the_curves_of_a_calibration_file_are_checked(checking: Checking) -> None:
    tank = {"curve": {"axis": [0, 5, 9]}, "lower": 0, "upper": 9}
    parameters, baseline = (MANIFEST[name] | {"tank": given} for name, given in (("parameters", tank), ("baseline", [1, 2, 3])))
    push(checking.api.database, checking.folder / "heater", parameters=parameters, baseline=baseline)
    seen = []

    def answer(scenario: str, cell: Cell) -> CellResult:
        seen.append([cell.parameters[f"tank_{number}"] for number in (1, 2, 3)])
        return heated(scenario, cell)

    checking.backend.answer = answer
    values = [f"FESTWERT {name}\n WERT {value}\nEND" for name, value in (("gain", 0.5), ("stage", 1), ("rooms", 3))]
    curve = 'KENNLINIE ACC_tank 3\n ST/X 0 5 9\n WERT 4 2.5 7\nEND\nFESTWERT mode\n TEXT "eco"\nEND\n'
    file = checking.file("set.dcm", "\n".join(["KONSERVIERUNG_FORMAT 2.0", *values, curve]))
    checked = checking(file, "--problem", "heater", "--names", checking.file("names.yaml", "tank: ACC_tank"))
    assert (checked.exit_code, seen) == (0, [[4.0, 2.5, 7.0]] * 2), checked.output
    assert "parameters.tank" in checking(file, "--problem", "heater").output
    other = checking.file("other.dcm", Path(file).read_text().replace("FESTWERT gain\n", 'FESTWERT gain\n EINHEIT_W "1/min"\n'))
    assert "parameters.gain" in checking(other, "--problem", "heater").output
    others = checking.file("four.json", MANIFEST["baseline"] | {f"tank_{number}": 1 for number in (1, 2, 3, 4)})
    assert "parameters.tank" in checking(others, "--problem", "heater").output  # of four points or coefficients
    parameters["tank"] = tank | {"curve": {"axis": [0, 6, 9]}}  # values of other points are no values of these
    push(checking.api.database, checking.folder / "heater", parameters=parameters, baseline=baseline)
    moved = checking(file, "--problem", "heater", "--names", checking.file("names.yaml", "tank: ACC_tank"))
    assert (moved.exit_code, len(seen)) == (2, 2)
    assert "parameters.tank" in moved.output
    checking.backend.answer = heated
    parameters["tank"] = tank | {"coefficients": 2}
    push(checking.api.database, checking.folder / "heater", parameters=parameters, baseline=baseline)
    chosen = (file, "--problem", "heater", "--names", checking.file("names.yaml", "tank: ACC_tank"))
    noted = json.loads(checking(*chosen, "--baseline", file, "--json").stdout)["notes"]
    assert [note.split(": ")[:-1] for note in noted] == [["baseline", "parameters.tank"], ["parameters.tank"]]


def test_a_limit_that_cannot_be_checked_is_refused_by_its_field(checking: Checking) -> None:
    unknown: list[tuple[dict[str, Any], str]] = [
        ({"score": "other", "at_least": 1}, "limits[0].score"),
        ({"measure": "other", "at_least": 1}, "limits[0].measure"),
        ({"score": "comfort", "at_least": 1, "scenarios": ["S9"]}, "limits[0].scenarios"),
        ({"score": "comfort", "worse_by_at_most": 1}, "limits[0].worse_by_at_most"),
        ({"score": "comfort"}, "limits[0]"),
    ]
    for limit, field in unknown:
        refused = checking(checking.file("set.json", BASELINE), "--limits", checking.file("limits.json", {"limits": [limit]}))
        assert refused.exit_code == 2
        assert field in refused.output
    assert checking(checking.file("set.json", {"parameters": None})).exit_code == 2
    assert not checking.backend.sent


@pytest.mark.parametrize("name", ["github", "gitlab"])
def test_the_examples_for_ci_use_options_that_exist(name: str) -> None:
    document = yaml.safe_load((PROJECT / "deploy" / "examples" / "ci" / f"{name}.yaml").read_text())
    job = document["jobs"]["check"] if name == "github" else document["calibration"]
    lines = [step.get("run", "") for step in job["steps"]] if name == "github" else job["script"]
    (line,) = [line for line in lines if line.startswith("drivecal check")]
    known = typer.main.get_command(app).commands["check"].params  # type: ignore[attr-defined]  # a group
    assert set(re.findall(r"--[a-z]+", line)) <= {option for parameter in known for option in parameter.opts}

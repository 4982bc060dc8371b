"""`drivecal report`, `explain` and the account that `show` prints, against a real server over HTTP."""

import csv
import json
from pathlib import Path

import pytest
from tests.support.answered_campaigns import analyse, carry_out
from tests.support.command import Run
from tests.support.server import RunningApi


@pytest.fixture(scope="module")
def ended(api: RunningApi) -> str:
    """A campaign with a map and one generation, every cell simulated."""
    document = {
        "name": "to be <b>reported</b>",
        "catalogue": ["S1", "S4"],
        "sensitivity": {"intervals": 5, "samples": 2},
        "optimizer": {"population": 10, "iterations": 3},
    }
    identifier = str(api.http.post("/api/v1/campaigns", json=document).raise_for_status().json()["id"])
    analyse(api.database, identifier, lambda scenario, values: 3 + (scenario == "S1" and values["P2"] > 1))
    carry_out(api.database, identifier)
    return identifier


def test_a_report_is_written_from_what_the_server_answers(run: Run, ended: str, tmp_path: Path) -> None:
    folder = tmp_path / "report"
    result = run("report", ended[:12], "-o", str(folder), "--json")
    assert result.exit_code == 0, result.output
    answer = json.loads(result.stdout)
    assert answer["campaign"] == ended
    assert answer["page"] == str(folder / "index.html")
    assert {path for path in folder.rglob("*") if path.is_file()} == {Path(name) for name in answer["files"]}
    tables = {path.stem: list(csv.DictReader(path.open(newline=""))) for path in (folder / "tables").iterdir()}
    counts = {"generations": 1, "solutions": 5, "front": 1, "influence": 22, "robustness": 0, "validation": 0}
    assert {name: len(rows) for name, rows in tables.items()} == counts
    page = (folder / "index.html").read_text()
    again = run("report", ended, "-o", str(folder))
    assert again.exit_code == 0
    assert again.stdout.startswith(f"{folder / 'index.html'}: ")
    assert f" {len(answer['files']) - 1} " in again.stdout
    assert (folder / "index.html").read_text() == page, "the same campaign gives the same page"


@pytest.mark.slow
def test_the_reports_campaign_can_be_submitted_again(run: Run, ended: str, tmp_path: Path) -> None:
    run("report", ended, "-o", str(tmp_path))
    result = run("submit", str(tmp_path / "campaign.json"), "--dry-run")
    assert result.exit_code == 0, result.output


def test_a_report_that_cannot_be_made_says_why(run: Run, api: RunningApi, ended: str, tmp_path: Path) -> None:
    assert run("report", "0" * 32, "-o", str(tmp_path / "report")).exit_code == 5
    assert run("report", ended).exit_code == 2
    (tmp_path / "file").write_text("")
    refused = run("report", ended, "-o", str(tmp_path / "file"))
    assert refused.exit_code == 2
    assert "report" in refused.stderr
    parameters = {f"P{number}": 1 for number in range(1, 12)}
    single = api.http.post("/api/v1/evaluations", json={"parameters": parameters}).raise_for_status().json()["id"]
    assert run("report", single, "-o", str(tmp_path / "report")).exit_code == 1
    assert not (tmp_path / "report").exists()


def test_a_cell_is_explained_within_its_campaign(run: Run, api: RunningApi, ended: str) -> None:
    number = api.http.get(f"/api/v1/campaigns/{ended}/evaluations?limit=1").json()["items"][0]["id"]
    outcome = json.loads(run("explain", ended[:12], str(number), "--json").stdout)
    assert (outcome["evaluation"], outcome["campaign"], outcome["outcome"]) == (number, ended, "simulated")
    printed = run("explain", ended, str(number))
    assert printed.exit_code == 0, printed.output
    where, values, result = printed.stdout.splitlines()[:3]
    assert where == f"evaluation {number}: calibration, iteration 1, individual 0, S1"
    assert values.startswith("P1=")
    assert result == "simulated, score 0"
    assert outcome["sentence"] in printed.stdout
    assert run("explain", ended, "999999999").exit_code == 5
    assert run("explain", ended, "nonsense").exit_code == 5
    other = api.http.post("/api/v1/campaigns", json={"sensitivity": None}).raise_for_status().json()["id"]
    wrong = run("explain", other, str(number))
    assert wrong.exit_code == 5
    assert ended in wrong.stderr


def test_show_prints_the_account_and_gives_it_as_json(run: Run, api: RunningApi, ended: str) -> None:
    printed = run("show", ended).stdout
    shown = json.loads(run("show", ended, "--json").stdout)
    assert shown["cells"]["requested"] == 10
    assert shown["id"] == ended
    assert "in CPU time of the workers" in printed
    assert shown["accounting"]["sentence"] in printed
    queued = api.http.post("/api/v1/campaigns", json={}).raise_for_status().json()["id"]
    assert json.loads(run("show", queued, "--json").stdout)["accounting"] is None

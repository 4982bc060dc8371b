"""The command line against a real server over HTTP; what the dispatcher would store is stored by hand."""

from __future__ import annotations

import csv
import io
import json
import os
import pty
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from tests.support.answered_campaigns import carry_out, carry_out_evaluation
from tests.support.command import Run
from tests.support.server import RunningApi, free_port
from tests.support.values import MIDDLE
from typer.testing import CliRunner

from drivecal.cli.main import app
from drivecal.domain.campaigns import CampaignState
from drivecal.storage import campaigns
from drivecal.storage.engine import locks

SETS = [f"{name}={value}" for name, value in MIDDLE.items()]


@pytest.fixture
def submitted(run: Run, tmp_path: Path) -> str:
    file = tmp_path / "campaign.yaml"
    file.write_text("name: mine\ncatalogue: [S1, S4]\noptimizer: {population: 10, iterations: 3}\n")
    result = run("submit", str(file), "--json")
    assert result.exit_code == 0, result.output
    return str(json.loads(result.stdout)["id"])


def test_submit_says_how_to_follow_and_list_shows_it(run: Run) -> None:
    result = run("submit", "-", stdin="name: from a pipe")
    assert result.exit_code == 0
    assert "drivecal watch" in result.stderr
    identifier = result.stdout.split()[1]
    lines = run("list", "--limit", "1").stdout.splitlines()
    assert lines[0].split() == ["id", "state", "kind", "created", "requested", "simulated", "saved", "best", "tags", "name"]
    assert lines[1].startswith(f"{identifier}  queued  calibration  ")
    assert lines[1].endswith("from a pipe")


def test_a_dry_run_counts_the_runs_and_submits_nothing(run: Run, api: RunningApi) -> None:
    before = api.http.get("/api/v1/campaigns?limit=1").json()
    result = run("submit", "-", "--dry-run", stdin="optimizer: {population: 10, iterations: 3}")
    assert result.exit_code == 0
    assert "180 cells" in result.stdout
    assert json.loads(run("submit", "-", "--dry-run", "--json", stdin="{}").stdout)["calibration_proposed"] == 120_000
    assert api.http.get("/api/v1/campaigns?limit=1").json() == before


@pytest.mark.parametrize("command", [["submit", "-"], ["submit", "-", "--dry-run"]])
def test_everything_wrong_with_a_file_is_said_on_one_line_each(run: Run, command: list[str]) -> None:
    result = run(*command, stdin="weights: {S1: 0, S9: 1}\nfixed: {P1: 0.1}\nbaseline: {P2: 0}\n")
    assert result.exit_code == 2
    assert result.stdout == ""
    assert "drivecal: standard input: line 1: weights.S9:" in result.stderr
    assert "line 2: fixed.P1: 0.1" in result.stderr
    assert "Traceback" not in result.stderr


def test_a_file_that_cannot_be_read_is_a_usage_error(run: Run, tmp_path: Path) -> None:
    result = run("submit", str(tmp_path / "nothing.yaml"))
    assert result.exit_code == 2
    assert "nothing.yaml: " in result.stderr


def test_show_takes_the_first_characters_of_an_id(run: Run, submitted: str) -> None:
    assert submitted in run("show", submitted[:10]).stdout
    assert json.loads(run("show", submitted[:10], "--json").stdout)["id"] == submitted


@pytest.mark.parametrize(
    ("command", "identifier"),
    [
        *(("show", identifier) for identifier in ("nothing", "../workers", "a b\x00", "é")),
        *((command, "0" * 32) for command in ("show", "watch", "pause", "resume", "cancel", "solutions", "export")),
    ],
)
def test_an_unknown_campaign_is_not_found(run: Run, command: str, identifier: str) -> None:
    result = run(command, identifier)
    assert result.exit_code == 5, result.output
    assert "`drivecal list`" in result.stderr


@pytest.mark.slow
def test_a_prefix_of_several_ids_is_not_found(run: Run) -> None:
    for _ in range(17):  # two of them begin with the same character
        run("submit", "-", stdin="{}")
    ids = [one["id"] for one in json.loads(run("list", "--limit", "200", "--json").stdout)["items"]]
    shared = next(first for first in "0123456789abcdef" if sum(one.startswith(first) for one in ids) > 1)
    result = run("show", shared)
    assert result.exit_code == 5


def test_steering_a_campaign(run: Run, submitted: str) -> None:
    assert json.loads(run("pause", submitted, "--json").stdout)["state"] == "paused"
    assert json.loads(run("resume", submitted, "--json").stdout)["state"] == "queued"
    assert "queued" in run("resume", submitted).stderr
    assert "cancelled" in run("cancel", submitted).stdout
    assert run("cancel", submitted).exit_code == 0
    late = run("pause", submitted)
    assert late.exit_code == 1


def test_watching_ends_with_the_campaign_and_its_exit_code(run: Run, api: RunningApi, submitted: str) -> None:
    timer = threading.Timer(3.0, carry_out, (api.database, submitted))
    timer.start()
    result = run("watch", submitted, "--json")
    timer.join()
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["state"] == "succeeded"
    assert result.stderr.startswith("queued  degraded: ")
    assert result.stderr.splitlines()[-1].startswith("succeeded  10/10 cells  simulated 10")


def test_watching_a_campaign_that_failed_or_was_cancelled_says_so(run: Run, api: RunningApi, submitted: str) -> None:
    run("cancel", submitted)
    assert run("watch", submitted).exit_code == 3
    failed = json.loads(run("submit", "-", "--json", stdin="{}").stdout)["id"]
    with api.database.transaction() as connection:
        campaigns.end(connection, campaigns.get(connection, failed).sequence, CampaignState.FAILED, "no worker starts")
    result = run("watch", failed)
    assert result.exit_code == 1
    assert "no worker starts" in result.stdout


def test_waiting_has_an_end(run: Run, submitted: str) -> None:
    result = run("watch", submitted, "--timeout", "0.2")
    assert result.exit_code == 6
    assert f"drivecal watch {submitted}" in result.stderr
    assert run("submit", "-", "--wait", "--timeout", "0", stdin="{}").exit_code == 6
    waited = run("evaluate", *SETS, "--timeout", "0")
    assert waited.exit_code == 6
    (command,) = re.findall(r"`drivecal (show \w+)`", waited.stderr)
    shown = run(*command.split(), "--json")
    assert json.loads(shown.stdout)["parameters"] == {name: float(value) for name, value in (pair.split("=") for pair in SETS)}
    assert run(*command.split()).stdout.splitlines()[0].endswith(" is queued")


def test_ctrl_c_detaches_and_cancels_nothing(api: RunningApi, submitted: str) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "drivecal.cli", "watch", submitted, "--url", api.url], stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    assert process.stderr.readline().startswith("queued  degraded: ")
    process.send_signal(2)
    said = process.stderr.read()
    assert process.wait(60) == 130
    assert f"drivecal watch {submitted}" in said
    assert "Traceback" not in said
    assert api.http.get(f"/api/v1/campaigns/{submitted}").json()["state"] == "queued"


def test_several_campaigns_stand_in_one_table(run: Run, api: RunningApi, submitted: str) -> None:
    carry_out(api.database, submitted)
    (row,) = json.loads(run("top", submitted[:8], "--json").stdout)["items"]
    assert (row["id"], row["state"], row["best_by_iteration"]) == (submitted, "succeeded", [3.5])
    assert row["outcomes"]["simulated"] == row["progress"]["done"] == 10
    queued = run("submit", "-", stdin="name: waiting").stdout.split()[1]
    header, first, *others = run("top", "--limit", "200").stdout.splitlines()
    assert header.split()[:3] == ["id", "state", "stage"]
    assert first.split()[1] == "queued", "what is active comes first"
    assert {queued[:8], submitted[:8]} <= {line.split()[0] for line in (first, *others)}
    assert run("top", "0" * 32).exit_code == 5


@pytest.mark.slow
def test_the_live_table_ends_with_ctrl_c(api: RunningApi, submitted: str) -> None:
    screen, terminal = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "drivecal.cli", "top", submitted, "--url", api.url],
        stdout=terminal,
        stderr=subprocess.PIPE,
        text=True,
    )
    os.close(terminal)
    shown = b""
    while submitted[:8].encode() not in shown:
        shown += os.read(screen, 1000)
    process.send_signal(2)
    _, said = process.communicate(timeout=60)
    os.close(screen)
    assert (process.returncode, said) == (0, "")


@pytest.mark.slow
def test_shells_complete_commands_and_ids(api: RunningApi, submitted: str) -> None:
    def completed(words: str) -> list[str]:
        asked = {"_DRIVECAL_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
        command = [str(Path(sys.executable).with_name("drivecal"))]
        environment = os.environ | asked | {"DRIVECAL_URL": api.url}
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.split()

    assert completed("drivecal to") == ["top"]
    assert completed(f"drivecal show {submitted[:6]}") == [submitted]


def test_solutions_are_ranked_by_other_weights(run: Run, api: RunningApi, submitted: str) -> None:
    assert json.loads(run("solutions", submitted, "--json").stdout)["items"] == []
    carry_out(api.database, submitted)
    lines = run("solutions", submitted, "--limit", "2").stdout.splitlines()
    assert lines[0].split()[:6] == ["rank", "objective", "rating", "S1", "S4", "P1"]
    assert lines[1].split()[:6] == ["1", "3.5000", "3.625", "4", "3", "-13"]
    assert len(lines) == 3
    other = json.loads(run("solutions", submitted, "--weights", "S1=3", "--json").stdout)
    assert other["items"][0]["objective"] == pytest.approx(3.75)
    assert run("solutions", submitted, "--weights", "S9=1").exit_code == 2
    wrong = run("solutions", submitted, "--weights", "S1")
    assert (wrong.exit_code, "--weights: S1 " in wrong.stderr) == (2, True)


@pytest.mark.slow
def test_a_rerun_needs_an_ended_campaign(run: Run, api: RunningApi, submitted: str) -> None:
    early = run("rerun", submitted, "--weights", "S1=2")
    assert early.exit_code == 1
    assert "is queued" in early.stderr
    carry_out(api.database, submitted)
    second = json.loads(run("rerun", submitted, "--weights", "S1=2,S4=1", "--name", "heavier", "--json").stdout)
    assert (second["name"], second["rerun_of"], second["spec"]["weights"]) == ("heavier", submitted, {"S1": 2, "S4": 1})
    known = json.loads(run("solutions", submitted, "--weights", "S1=2,S4=1", "--json").stdout)["items"][0]["parameters"]
    begun = json.loads(run("rerun", submitted, "--weights", "S1=2,S4=1", "--from-best", "--json").stdout)
    assert begun["spec"]["optimizer"]["start_sets"] == [known]
    assert run("rerun", submitted, "--evaluator", "learned", "--from-best").exit_code == 2
    third = json.loads(run("rerun", submitted, "--evaluator", "learned", "--json").stdout)
    assert (third["spec"]["evaluator"], third["rerun_of"]) == ("learned", submitted)
    assert run("rerun", submitted).exit_code == 2


def test_tables_are_exported_whole(run: Run, api: RunningApi, submitted: str, tmp_path: Path) -> None:
    carry_out(api.database, submitted)
    rows = list(csv.DictReader(io.StringIO(run("export", submitted).stdout)))
    assert len(rows) == 10
    file = tmp_path / "cells.parquet"
    result = run("export", submitted, "--format", "parquet", "-o", str(file))
    assert result.exit_code == 0
    assert str(file) in result.stderr
    assert pq.read_table(file).num_rows == 10
    assert len(json.loads(run("export", submitted, "--format", "json").stdout)) == 10
    assert json.loads(run("export", submitted, "--table", "influence", "--json").stdout) == []
    assert [
        row["iteration"] for row in csv.DictReader(io.StringIO(run("export", submitted, "--table", "generations").stdout))
    ] == ["0"]
    assert "score_S4" in run("export", submitted, "--table", "solutions").stdout


def test_the_set_of_a_rank_goes_to_calibration_tools_and_back(
    run: Run, api: RunningApi, submitted: str, tmp_path: Path
) -> None:
    carry_out(api.database, submitted)
    best = json.loads(run("solutions", submitted, "--json").stdout)["items"][1]
    names = tmp_path / "names.yaml"
    names.write_text("P1: ACC_tGap_C\nP3: ACC_v_C\n")
    shape = ("export", submitted, "--table", "solutions", "--row", "2")
    for form in ("dcm", "cdfx"):
        file = tmp_path / f"set.{form}"
        result = run(*shape, "--format", form, "-o", str(file), "--names", str(names))
        assert result.exit_code == 0, result.output
        assert submitted in file.read_text()
        first = file.read_bytes()
        run(*shape, "-o", str(file), "--names", str(names))  # the ending says the format
        assert file.read_bytes() == first
        back = json.loads(run("parameters", str(file), "--names", str(names), "--json").stdout)
        assert back["baseline"] == best["parameters"]
    assert "ACC_tGap_C: {" in run("parameters", str(file)).stdout
    rows = list(csv.DictReader(io.StringIO(run(*shape, "--names", str(names)).stdout)))
    assert {row["name"]: float(row["value"]) for row in rows}["ACC_v_C"] == best["parameters"]["P3"]
    for wrong in (
        ("export", submitted, "--format", "dcm"),
        (*shape[:-1], "999", "--format", "dcm"),
        (*shape, "--format", "parquet"),
        ("parameters", str(names)),
    ):
        assert run(*wrong).exit_code == 2, wrong


def test_an_export_that_cannot_be_written_leaves_nothing_behind(run: Run, submitted: str, tmp_path: Path) -> None:
    result = run("export", submitted, "-o", str(tmp_path / "no" / "cells.csv"))
    assert result.exit_code == 2
    assert str(tmp_path / "no") in result.stderr
    assert run("export", "0" * 32, "-o", str(tmp_path / "cells.csv")).exit_code == 5
    assert {path.name for path in tmp_path.iterdir()} == {"campaign.yaml"}


def test_an_evaluation_is_waited_for_and_shown(run: Run, api: RunningApi) -> None:
    def answer() -> None:
        for _ in range(200):
            with api.database.read() as connection:
                waiting = [one.id for one in campaigns.active(connection) if one.kind == "evaluation"]
            for identifier in waiting:
                carry_out_evaluation(api.database, identifier)
            if waiting:
                return
            time.sleep(0.05)

    with api.database.transaction() as connection:
        for one in campaigns.active(connection):
            campaigns.end(connection, one.sequence, CampaignState.CANCELLED)
    thread = threading.Thread(target=answer)
    thread.start()
    result = run("evaluate", *SETS, "--scenario", "S2")
    thread.join()
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith("P1=0 P2=1 P3=100")
    assert "S2        simulated      0" in result.stdout
    assert "peak_lateral_acceleration_mps2   1.25" in result.stdout


def test_an_evaluation_that_cannot_run_is_a_usage_error(run: Run) -> None:
    assert "parameters.P11: " in run("evaluate", *SETS[:-1]).stderr
    assert "parameters.P10, parameters.P11: " in run("evaluate", *SETS[:-2]).stderr
    assert run("evaluate", *SETS, "--scenario", "S9").exit_code == 2
    assert run("evaluate", "P1=1", "P1=2").exit_code == 2
    assert "parameters.P1: " in run("evaluate", "P1=nan").stderr
    other = ("--vehicle", "hybrid", "--vehicle-parameters", "mass=1800,mas=1", "--driving-function", "frenet")
    assert "vehicle.parameters.mas: " in run("evaluate", *SETS, *other).stderr


def test_influence_maps_are_posted_listed_and_shown(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "map.yaml"
    file.write_text("name: mine\nscenarios: {S1: {P1: {lower: -10, upper: 3.5}, P2: {influential: false}}}\n")
    posted = json.loads(run("influence-maps", "post", str(file), "--json").stdout)
    assert posted["id"] in run("influence-maps", "list").stdout
    assert "P1         yes            -10    3.5  dB" in run("influence-maps", "show", posted["id"]).stdout
    named = "sensitivity: {{map: {}}}\nrobustness: {{of: nobody}}\noptimizer: null\n"
    short = run("submit", "-", "--dry-run", stdin=named.format(posted["id"][:12]))
    assert "robustness.of: " in short.stderr
    assert "'nobody'" in short.stderr
    assert "`drivecal list`" in short.stderr
    unknown = run("submit", "-", "--dry-run", stdin=named.format("nowhere"))
    assert "`drivecal influence-maps list`" in unknown.stderr
    file.write_text("scenarios: {S1: {P1: {lower: -10.2}}}\n")
    refused = run("influence-maps", "post", str(file))
    assert refused.exit_code == 2
    assert "-10.5 or -10" in refused.stderr
    assert run("influence-maps", "show", "0" * 32).exit_code == 5


def test_workers_says_when_there_are_none(run: Run) -> None:
    result = run("workers")
    assert result.exit_code == 0
    assert json.loads(run("workers", "--json").stdout)["items"] == []


@pytest.mark.parametrize(
    "arguments",
    [["list"], ["show", "x"], ["submit", "-"], ["evaluate", *SETS], ["workers"], ["influence-maps", "list"]],
)
def test_a_server_that_is_not_there_is_named_with_what_to_do(arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    url = f"http://127.0.0.1:{free_port()}"
    monkeypatch.setenv("DRIVECAL_URL", url)
    result = CliRunner().invoke(app, arguments, input="{}")
    assert result.exit_code == 4
    assert url in result.stderr
    assert "drivecal serve" in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_the_database_is_made_and_checked(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'new' / 'drivecal.db'}"
    missing = CliRunner().invoke(app, ["db", "check", "--database-url", url])
    assert missing.exit_code == 1
    assert "drivecal db upgrade" in missing.stderr
    assert CliRunner().invoke(app, ["db", "upgrade", "--database-url", url]).exit_code == 0
    assert json.loads(CliRunner().invoke(app, ["db", "check", "--database-url", url, "--json"]).stdout)["current"]
    (tmp_path / "text.db").write_text("this is no database, and long enough to be seen as one or not")
    with locks.hold(url):
        assert CliRunner().invoke(app, ["db", "check", "--database-url", url]).exit_code == 0, "looking is free"
        assert CliRunner().invoke(app, ["db", "upgrade", "--database-url", url]).exit_code == 0, "there is nothing to do"
    unmade = f"sqlite:///{tmp_path / 'unmade.db'}"
    with locks.hold(unmade):
        refused = CliRunner().invoke(app, ["db", "upgrade", "--database-url", unmade])
        assert (refused.exit_code, f"server (process {os.getpid()})" in refused.stderr) == (1, True)
    broken = CliRunner().invoke(app, ["db", "upgrade", "--database-url", f"sqlite:///{tmp_path / 'text.db'}"])
    assert broken.exit_code == 1
    assert "text.db" in broken.stderr

"""The command line against a real server over HTTP; what the dispatcher would store is stored by hand."""

import csv
import io
import json
import os
import stat
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest
import yaml
from tests.support.answered_campaigns import METRICS, carry_out
from tests.support.command import Run
from tests.support.computed import ComputedBackend
from tests.support.runs import working
from tests.support.server import RunningApi, free_port, serving
from tests.support.values import MIDDLE
from typer.testing import CliRunner

from drivecal.cli.__main__ import app
from drivecal.contracts.work import CellResult
from drivecal.storage.engine import server_lock

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
    columns = ["id", "state", "kind", "created", "requested", "simulated", "saved", "best", "owner", "tags", "name"]
    assert lines[0].split() == columns
    assert lines[1].startswith(f"{identifier}  queued  calibration  ")
    assert lines[1].endswith("from a pipe")


def test_a_dry_run_counts_the_runs_and_submits_nothing(run: Run, api: RunningApi) -> None:
    before = api.http.get("/api/v1/campaigns?limit=1").json()
    result = run("submit", "-", "--dry-run", stdin="optimizer: {population: 10, iterations: 3}")
    assert result.exit_code == 0
    assert "180 cells" in result.stdout
    assert json.loads(run("submit", "-", "--dry-run", "--json", stdin="{}").stdout)["calibration_at_most"] == 600
    assert api.http.get("/api/v1/campaigns?limit=1").json() == before


def test_steering_a_campaign(run: Run, submitted: str) -> None:
    assert json.loads(run("pause", submitted, "--json").stdout)["state"] == "paused"
    assert json.loads(run("resume", submitted, "--json").stdout)["state"] == "queued"
    assert "queued" in run("resume", submitted).stdout
    assert "cancelled" in run("cancel", submitted).stdout
    assert run("cancel", submitted).exit_code == 0
    late = run("pause", submitted)
    assert late.exit_code == 1


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
    assert json.loads(run("importance", submitted, "--json").stdout)["items"] == []


def test_a_ranked_set_goes_to_calibration_tools_and_back(run: Run, api: RunningApi, submitted: str, tmp_path: Path) -> None:
    carry_out(api.database, submitted)
    best = json.loads(run("solutions", submitted, "--json").stdout)["items"][1]
    names = tmp_path / "names.yaml"
    names.write_text("P1: ACC_tGap_C\nP3: ACC_v_C\n")
    shape = ("export", submitted, "--row", "2")
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
    assert json.loads(run(*shape, "--json").stdout)["parameters"] == best["parameters"]
    longest = tmp_path / f"{250 * 's'}.dcm"
    longest.touch(0o640)
    assert run(*shape, "-o", str(longest)).exit_code == 0
    assert stat.S_IMODE(longest.stat().st_mode) == 0o640
    run("export", submitted, "--row", "2", "-o", str(tmp_path / "set.yaml"))
    assert yaml.safe_load((tmp_path / "set.yaml").read_text()) == {"parameters": best["parameters"]}
    assert "ACC_tGap_C: {" in run("parameters", str(file)).stdout
    described = tmp_path / "ecu.a2l"
    described.write_text("""/begin PROJECT p "" /begin CHARACTERISTIC ACC_tGap_C "" VALUE 0 L 0 NO_COMPU_METHOD 0 9
CALIBRATION_ACCESS NO_CALIBRATION /end CHARACTERISTIC /end PROJECT""")
    assert "ACC_tGap_C: {" not in run("parameters", str(described), str(file)).stdout
    rows = list(csv.DictReader(io.StringIO(run(*shape, "--names", str(names)).stdout)))
    assert {row["name"]: float(row["value"]) for row in rows}["ACC_v_C"] == best["parameters"]["P3"]
    for wrong in (
        ("export", submitted, "--table", "evaluations", "--format", "dcm"),
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
    assert run("export", submitted, "-o", str(tmp_path / "cells.xlsx")).exit_code == 2
    assert {path.name for path in tmp_path.iterdir()} == {"campaign.yaml"}


def test_an_evaluation_is_waited_for_and_shown(run: Run, tmp_path: Path) -> None:
    backend = ComputedBackend(answer=lambda _, cell: CellResult(cell.id, 0.0, 0, METRICS, None, 7.0))
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}") as api, working(api.database, backend):
        result = run("evaluate", *SETS, "--scenario", "S2", "--url", api.url)
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith("P1=0 P2=1 P3=100")
    assert "S2        simulated      0" in result.stdout
    assert "peak_lateral_acceleration_mps2   1.25" in result.stdout


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
    "arguments", [["list"], ["show", "x"], ["submit", "-"], ["evaluate", *SETS], ["workers"], ["influence-maps", "list"]]
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
    with server_lock.hold(url):
        assert CliRunner().invoke(app, ["db", "check", "--database-url", url]).exit_code == 0, "looking is free"
        assert CliRunner().invoke(app, ["db", "upgrade", "--database-url", url]).exit_code == 0, "there is nothing to do"
    unmade = f"sqlite:///{tmp_path / 'unmade.db'}"
    with server_lock.hold(unmade):
        refused = CliRunner().invoke(app, ["db", "upgrade", "--database-url", unmade])
        assert (refused.exit_code, f"server (process {os.getpid()})" in refused.stderr) == (1, True)
    broken = CliRunner().invoke(app, ["db", "upgrade", "--database-url", f"sqlite:///{tmp_path / 'text.db'}"])
    assert broken.exit_code == 1
    assert "text.db" in broken.stderr

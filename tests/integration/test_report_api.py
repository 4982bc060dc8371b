"""The report that the API writes: the page alone and all files, with the rights of the request."""

import io
import subprocess
import sys
import zipfile
from pathlib import Path

import httpx
import pytest
from tests.support.answered_campaigns import carry_out
from tests.support.command import Run
from tests.support.server import RunningApi, serving
from tests.support.values import MIDDLE

from drivecal.client import Client


@pytest.fixture(scope="module")
def ended(api: RunningApi) -> str:
    """A campaign with two generations, every cell simulated."""
    document = {"name": "to be <reported>", "catalogue": ["S1"], "optimizer": {"population": 10, "iterations": 2}}
    identifier = str(api.http.post("/api/v1/campaigns", json=document).raise_for_status().json()["id"])
    carry_out(api.database, identifier)
    return identifier


@pytest.mark.slow
def test_the_page_needs_no_other_file_and_no_script(api: RunningApi, ended: str) -> None:
    links = api.http.get(f"/api/v1/campaigns/{ended}").json()["links"]
    response = api.http.get(links["report"])
    assert response.status_code == 200, response.text
    assert response.headers["content-type"].startswith("text/html")
    assert "default-src 'none'" in response.headers["content-security-policy"]
    page = response.text
    assert "to be &lt;reported&gt;" in page
    assert page.count("<svg") >= 2
    assert 'href="figures' not in page
    assert 'href="tables' not in page
    assert "<script" not in page
    with Client(api.url) as client:
        assert client.report(ended[:8]).decode() == page


@pytest.mark.slow
def test_the_archive_holds_what_the_command_writes(api: RunningApi, run: Run, ended: str, tmp_path: Path) -> None:
    response = api.http.get(f"/api/v1/campaigns/{ended}/report", params={"format": "zip"})
    assert response.headers["content-type"] == "application/zip"
    assert response.headers["content-disposition"] == f'attachment; filename="report-{ended}.zip"'
    archive = zipfile.ZipFile(io.BytesIO(response.content))
    assert run("report", ended, "-o", str(tmp_path)).exit_code == 0
    written = {path.relative_to(tmp_path).as_posix(): path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert set(archive.namelist()) == written.keys()
    for name in ("tables/solutions.csv", "campaign.json"):
        assert archive.read(name) == written[name]
    assert 'href="figures/' in archive.read("index.html").decode()


@pytest.mark.slow
def test_a_single_evaluation_has_no_report(api: RunningApi) -> None:
    evaluation = api.http.post("/api/v1/evaluations", json={"parameters": MIDDLE, "scenario": "S1"}).json()
    assert api.http.get(f"/api/v1/campaigns/{evaluation['id']}/report").status_code == 409
    assert api.http.get(f"/api/v1/campaigns/{'0' * 32}/report").status_code == 404


def test_a_report_is_read_with_the_rights_of_its_request(tmp_path: Path) -> None:
    (tmp_path / "tokens").write_text(f"reader read {'r' * 40}\n")
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}", tokens_file=str(tmp_path / "tokens")) as api:
        place = f"{api.url}/api/v1/campaigns/{'0' * 32}/report"
        assert httpx.get(place).status_code == 401
        assert httpx.get(place, headers={"Authorization": f"Bearer {'r' * 40}"}).status_code == 404


def test_the_server_itself_loads_no_plotting() -> None:
    program = "import sys, drivecal.api.app; sys.exit('matplotlib' in sys.modules or 'jinja2' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0

"""Downloaded tables and time series as frames, files and tables of notebooks."""

import io
import json
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pyarrow as pa
import pytest
from pyarrow import parquet
from tests.support.scripted import campaign, server

from drivecal.cli.commands.evaluate import save_series
from drivecal.client import Client, DownloadedTable
from drivecal.contracts.campaign import Campaign, CampaignPage
from drivecal.contracts.evaluation import SeriesAnswer


@pytest.fixture
def downloaded() -> tuple[DownloadedTable, str]:
    """A table without a value in its second row, and the path of its request."""
    content = io.BytesIO()
    columns = {"id": pa.array([7, None], pa.int64()), "agrees": pa.array([True, None]), "rating": pa.array([6.5, None])}
    parquet.write_table(pa.table(columns), content)
    with server((200, {}, content.getvalue())) as (client, script):
        table = client.evaluations("c1", where=["scenario=S1"], score=None)
    return table, script.requests[0][1]


def test_a_table_comes_whole_and_filtered(downloaded: tuple[DownloadedTable, str]) -> None:
    table, path = downloaded
    assert path == "/api/v1/campaigns/c1/evaluations?where=scenario%3DS1&format=parquet"
    assert table.to_arrow().to_pylist() == [{"id": 7, "agrees": True, "rating": 6.5}, dict.fromkeys(("id", "agrees", "rating"))]


def test_frames_of_pandas_keep_the_types_of_columns_with_missing_values(downloaded: tuple[DownloadedTable, str]) -> None:
    frame = downloaded[0].to_pandas()
    assert frame.dtypes.map(str).to_dict() == {"id": "Int64", "agrees": "boolean", "rating": "float64"}
    assert frame["id"][0] == 7


def test_polars_reads_the_downloaded_file(downloaded: tuple[DownloadedTable, str], monkeypatch: pytest.MonkeyPatch) -> None:
    read = SimpleNamespace(read_parquet=lambda file: parquet.read_table(file).num_rows)
    monkeypatch.setitem(sys.modules, "polars", read)
    assert downloaded[0].to_polars() == 2


def test_a_missing_package_is_named(downloaded: tuple[DownloadedTable, str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "polars", None)
    with pytest.raises(ImportError, match="polars"):
        downloaded[0].to_polars()


def test_the_python_of_the_readme_runs(monkeypatch: pytest.MonkeyPatch, downloaded: tuple[DownloadedTable, str]) -> None:
    text = (Path(__file__).parents[3] / "README.md").read_text()
    (source,) = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    middle = dict(zip([f"P{n}" for n in range(1, 12)], [-0.5, 1, 100, 1000, 750, 0.5, 100, 1000, 5, 10, 100], strict=True))
    best = SimpleNamespace(items=[SimpleNamespace(parameters=middle)])
    monkeypatch.chdir(Path(__file__).parents[3])
    monkeypatch.setattr(Client, "solutions", lambda *_, **__: best)
    with server(campaign("queued"), campaign("succeeded"), (200, {}, downloaded[0].content)) as (given, script):
        monkeypatch.setenv("DRIVECAL_URL", given.url)
        names: dict[str, Any] = {}
        exec(source, names)  # the documentation's own code
    assert len(names["evaluations"]) == 2
    assert names["result"].scores["S1"] is not None
    assert not script.answers


def test_time_series_of_a_bundle_are_those_of_its_simulator() -> None:
    body = {"measures": {"cost": 2.0, "gap": None}, "failure": "collision", "series": {"v": [1.0, 2.0], "gap": [3.0]}}
    with server((200, {"Content-Type": "application/json"}, json.dumps(body).encode())) as (client, _):
        trace = client.trace("7")
    assert isinstance(trace, SeriesAnswer)
    assert (trace.failure, trace.measures, trace.series["v"]) == ("collision", {"cost": 2.0, "gap": None}, [1.0, 2.0])


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".json"])
def test_series_of_different_lengths_are_saved(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"series{suffix}"
    save_series(SeriesAnswer(measures={}, failure=None, series={"v": [1.0, 2.0], "gap": [3.0]}), file)
    if suffix == ".csv":
        assert file.read_text().splitlines() == ["v,gap", "1.0,3.0", "2.0,"]
    elif suffix == ".parquet":
        assert parquet.read_table(file).to_pydict() == {"v": [1.0, 2.0], "gap": [3.0, None]}
    else:
        assert json.loads(file.read_text())["series"] == {"v": [1.0, 2.0], "gap": [3.0]}


FULL = "5050a77ddf5e42199c25aff35a3b4568"


def test_answers_are_tables_in_notebooks(downloaded: tuple[DownloadedTable, str], monkeypatch: pytest.MonkeyPatch) -> None:
    shown = Campaign.model_validate({"id": FULL, "name": "<mine>", "state": "running", "best": None})._repr_html_()
    assert "&lt;mine&gt;" in shown
    assert FULL in shown
    page = CampaignPage.model_validate({"items": [{"id": FULL, "name": "mine", "state": "running"}] * 30})
    assert page._repr_html_().count("<tr>") == 21
    assert "10 more rows" in page._repr_html_()
    assert "<table>" in str(downloaded[0]._repr_html_())
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    assert downloaded[0]._repr_html_() is None

"""The page and the files beside it."""

from __future__ import annotations

import csv
import json
import re
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path

import pytest
from tests.unit.report.rows import ROWS, findings, row

from drivecal.contracts.campaign import Campaign
from drivecal.domain.errors import InvalidInputError
from drivecal.report.findings import Findings
from drivecal.report.writing import write_report

VOID = {"meta", "link", "br"}


class Reader(HTMLParser):
    """Checks that elements are closed in order; collects text, ids, and all that would be fetched or run."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.fetched: list[str] = []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        given = dict(attributes)
        if tag not in VOID:
            self.open.append(tag)
        self.ids += [value for name, value in attributes if name == "id" and value]
        if tag == "a":
            self.links.append(given.get("href") or "")
        elif tag in {"script", "img", "iframe", "link", "object"}:
            self.fetched.append(given.get("src") or given.get("href") or tag)

    def handle_startendtag(self, _tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.ids += [value for name, value in attributes if name == "id" and value]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def read(page: str) -> Reader:
    reader = Reader()
    reader.feed(page)
    reader.close()
    assert reader.open == []
    return reader


def written(found: Findings, folder: Path) -> tuple[Reader, set[str]]:
    tables = {"generations": [b"iteration\n", b"0\n"], "solutions": [b"rank\n"]}
    paths = write_report(found, tables, folder)
    assert paths[-1] == folder / "index.html"
    assert all(path.stat().st_size for path in paths)
    return read(paths[-1].read_text()), {path.relative_to(folder).as_posix() for path in paths}


def test_a_report_has_its_figures_tables_and_page(tmp_path: Path) -> None:
    page, files = written(findings(), tmp_path / "new" / "report")
    names = ["9-influence", "9-S1", "9-S2", "10-population", "11-cells"]
    tables = ["generations", "solutions", "accounting", "balance"]
    assert files == {f"figures/figure-{name}.{form}" for name in names for form in ("svg", "png")} | {
        *(f"tables/{name}.csv" for name in tables),
        "campaign.json",
        "index.html",
    }
    assert set(page.links) == files - {"index.html"}
    folder = tmp_path / "new" / "report"
    assert (folder / "tables" / "generations.csv").read_bytes() == b"iteration\n0\n"
    assert json.loads((folder / "campaign.json").read_text()) == {"name": "study", "sensitivity": {"intervals": 5}}


def test_the_page_needs_nothing_from_anywhere(tmp_path: Path) -> None:
    page, _ = written(findings(), tmp_path)
    source = (tmp_path / "index.html").read_text()
    assert page.fetched == ["data:,"]
    assert "default-src 'none'" in source
    assert not re.search(r"@import|url\((?!#)|https?://(?!www\.w3\.org/)", source)
    assert "<script" not in source


def test_ids_of_several_drawings_do_not_meet(tmp_path: Path) -> None:
    page, _ = written(findings(), tmp_path)
    assert page.ids
    assert [name for name, count in Counter(page.ids).items() if count > 1] == []
    source = (tmp_path / "index.html").read_text()
    used = set(re.findall(r'(?:url\(|href=")#([^")]+)', source))
    assert used
    assert used <= set(page.ids)


def test_what_a_user_wrote_is_shown_and_not_obeyed(tmp_path: Path) -> None:
    page, _ = written(findings(titles={"S1": "<script>alert(1)</script>"}), tmp_path)
    assert "a <b>small</b> study" in page.text
    assert any("not simulated because their weight is 0: S3" in text for text in page.text)


def test_the_page_says_what_the_self_check_found_and_what_it_cost(tmp_path: Path) -> None:
    page, _ = written(findings(), tmp_path)
    text = "|".join(part for part in page.text if part.strip())
    for wanted in (
        "|12.50%|52.65%|",
        "|stopped|",
        "It lost 8.4 s.",
        "|net|-8.4|",
        "from 1,800 requested cells on, 23 campaigns",
        "|2 … 7.5|",
    ):
        assert wanted in text
    assert "3 parameter sets share it" in text


def test_the_account_adds_up_in_its_table(tmp_path: Path) -> None:
    written(findings(), tmp_path)
    with (tmp_path / "tables" / "accounting.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["scenario"] for row in rows] == ["S1", "S2", "all"]
    for field in ("requested", "reused", "simulated_seconds"):
        assert float(rows[2][field]) == pytest.approx(sum(float(row[field]) for row in rows[:2]))
    assert float(rows[2]["mean_seconds"]) == pytest.approx(0.02)
    balance = {row[0]: row[1] for row in csv.reader((tmp_path / "tables" / "balance.csv").read_text().splitlines())}
    saved = sum(float(balance[f"saved by {one} cells"]) for one in ("repeated", "reused", "certified"))
    assert float(balance["net"]) == pytest.approx(saved + float(balance["cost of the sensitivity stage"]))


def test_a_campaign_that_has_just_begun_has_a_report_too(tmp_path: Path) -> None:
    campaign = Campaign(id="1" * 32, name="new", state="queued")
    page, files = written(
        findings(campaign=campaign, generations=[], solutions=[], influence=[], accounting=None, basis=None), tmp_path
    )
    assert files == {"tables/generations.csv", "tables/solutions.csv", "campaign.json", "index.html"}
    assert "No parameter set has a result in every scenario." in page.text


def test_the_page_says_where_the_map_comes_from(tmp_path: Path) -> None:
    settings = {"design": "lines", "intervals": 5, "samples": 3, "threshold": "auto", "seed": 1}
    basis = {"sensitivity": settings, "runs": 2484, "simulated": 2329}
    text = "".join(written(findings(basis=basis, influence=[*ROWS, row("S3", "P1", unknown=True)]), tmp_path)[0].text)
    assert "design lines, 5 intervals, 3 samples" in text
    assert "2,484 runs asked for, 2,329 simulated" in text
    assert "unknown" in text
    assert "posted by a user" in "".join(written(findings(), tmp_path)[0].text)


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(InvalidInputError, match="it cannot be written") as refused:
        write_report(findings(), {}, tmp_path / "file" / "report")
    assert str(tmp_path / "file") in str(refused.value)

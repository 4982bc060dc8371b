"""The page of a report and the files beside it."""

import re
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from tests.unit.report.rows import CAMPAIGN, ROBUST, ROWS, SETUP, STUDIES, findings, results, row, study

from drivecal.analysis.verdicts import verdict
from drivecal.contracts.campaign import Campaign, FirstObjective, Released
from drivecal.contracts.evaluation import FailureCause
from drivecal.contracts.results import ResultTrust, StudyResult
from drivecal.domain.errors import InvalidInputError
from drivecal.report import sections
from drivecal.report.blocks import Table
from drivecal.report.data import Report, ReportData
from drivecal.report.page import page
from drivecal.report.writing import write

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


def written(found: ReportData, folder: Path, **options: bool) -> tuple[str, set[str]]:
    paths = write(Report(found, {"generations": [b"iteration\n", b"0\n"], "solutions": [b"rank\n"]}), folder, **options)
    assert paths[-1] == folder / "index.html"
    assert all(path.stat().st_size for path in paths)
    return paths[-1].read_text(), {path.relative_to(folder).as_posix() for path in paths}


def rows_of(blocks: Any) -> list[list[str]]:
    return [[str(value) for value in row] for block in blocks if isinstance(block, Table) for row in block.rows]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, set[str]]:
    return written(findings(), tmp_path_factory.mktemp("new") / "new" / "report")


def test_a_report_has_its_figures_tables_and_page(whole: tuple[str, set[str]]) -> None:
    source, files = whole
    names = [
        "9-influence", "10-population", "11-cells", "12-optima", "12-robustness", "14-validation",
    ]  # fmt: skip
    assert files == {f"figures/figure-{name}.{form}" for name in names for form in ("svg", "png")} | {
        "tables/generations.csv",
        "tables/solutions.csv",
        "campaign.json",
        "index.html",
    }
    reader = read(source)
    assert {link for link in reader.links if not link.startswith("#")} == files - {"index.html"}
    assert {link.removeprefix("#") for link in reader.links if link.startswith("#")} <= set(reader.ids)


def test_a_page_alone_links_to_no_file(tmp_path: Path) -> None:
    source, files = written(findings(), tmp_path, page_alone=True)
    assert files == {"index.html"}
    assert all(link.startswith("#") for link in read(source).links)


def test_the_page_needs_nothing_from_anywhere(whole: tuple[str, set[str]]) -> None:
    source, _ = whole
    assert read(source).fetched == ["data:,"]
    assert "default-src 'none'" in source
    assert not re.search(r"@import|url\((?!#)|https?://(?!www\.w3\.org/)", source)
    assert "<script" not in source


def test_ids_of_several_drawings_do_not_meet(whole: tuple[str, set[str]]) -> None:
    source, _ = whole
    ids = read(source).ids
    assert [name for name, count in Counter(ids).items() if count > 1] == []
    used = set(re.findall(r'(?:url\(|href=")#([^")]+)', source))
    assert used
    assert used <= set(ids)


def test_each_drawing_is_described(whole: tuple[str, set[str]]) -> None:
    source, _ = whole
    described = re.findall(r'<svg[^>]* role="img" aria-label="([^"]{40,})"', source)
    assert len(set(described)) == len(described) == source.count("<svg") == 6


def test_words_of_users_are_shown_and_not_obeyed() -> None:
    scenarios = [SETUP.scenarios[0].model_copy(update={"title": "<script>alert(1)</script>"})]
    text = page(findings(results(setup=SETUP.model_copy(update={"scenarios": scenarios}))), {}, [], "0")
    assert "<script>" not in text
    assert "a &lt;b&gt;small&lt;/b&gt; study" in text


def test_the_page_has_verdicts_by_question_and_the_account() -> None:
    known = ResultTrust(light="red", verdicts=[verdict("failed", "red", error="<no> memory"), verdict("not_better", "amber")])
    text = page(findings(results(trust=known)), {}, [], "0")
    assert "Light: red." in text
    assert text.index("Are the scores right?") < text.index("&lt;no&gt; memory") < text.index("Is the search finished?")
    assert "It lost 8.4 s." in text
    assert "Light:" not in page(findings(), {}, [], "0")


def test_an_account_adds_up_in_its_table() -> None:
    blocks = sections.account_blocks(results().accounting)
    assert rows_of(blocks) == [["reused cells", "+0.4"], ["analysis", "-9.0"], ["net", "-8.4"]]
    assert sections.account_blocks(None) == []


def test_checks_are_listed_by_scenario() -> None:
    audits = sections.audits_table(CAMPAIGN.error_rate, CAMPAIGN.scale)
    assert rows_of(audits) == [["S1", "8", "1", "1", "12.50%", "52.65%", "0", "0", "0"]]
    near = Released(asked=8, lots=7, rejected=1, predicted=1333, sampled=96, different=3, limit=0.05, upper_95=0.0432)
    lots = sections.lots_table({"S1": near, "S2": Released(limit=0.05)})
    assert rows_of(lots) == [["S1", "8", "7", "1", "1333", "96", "3", "5.0%", "4.32%"]]
    doubtful = sections.lots_table({"S1": near.model_copy(update={"upper_95": 1.0})})
    assert (len(lots), len(doubtful)) == (1, 2), "a bound beside a smaller limit is explained"
    assert rows_of(doubtful)[0][-1] == "no bound"


def test_failed_cells_are_listed_by_cause() -> None:
    causes = [
        FailureCause(
            kind="no_result", cause="crash", detail="x" * 300 + "no licence", scenarios=["S1", "S2"], cells=7, example=12
        ),
        FailureCause(kind="unscored", cause="division by zero", scenarios=["S1"], cells=2, example=3),
    ]
    (first, second) = rows_of(sections.failures_table(causes))
    assert first[:3] + first[4:] == ["7", "no result", "crash", "S1 S2", "12"]
    assert first[3].startswith("...x")
    assert first[3].endswith("no licence")
    assert second[1] == "score without a value"


def test_the_commands_drive_as_the_campaign_did() -> None:
    vehicle = {"model": "hybrid", "parameters": {"mass": 1800.5}}
    spec = {"catalogue": ["S1"], "vehicle": vehicle, "evaluator": "learned", "driving_function": "frenet"}
    known = results(
        campaign=CAMPAIGN.model_copy(update={"spec": spec}),
        setup=SETUP.model_copy(update={"scenarios": SETUP.scenarios[:1]}),
        studies=[StudyResult(study=study(vehicle="other"), robustness=ROBUST)],
    )
    text = page(findings(known), {}, [], "0")
    options = "--evaluator learned --vehicle {} --vehicle-parameters mass=1800.5 --scenario S1    # the {} set"
    assert options.format("hybrid", "best") in text
    assert options.format("other", "recommended") in text


def test_nothing_cites_a_figure_that_the_reader_does_not_have(whole: tuple[str, set[str]]) -> None:
    assert re.findall(r"\b(?:Figure|Table|Section|Equation) [0-9IVX]+", "|".join(read(whole[0]).text)) == []


def test_a_study_of_other_sets_is_not_said_to_have_failed() -> None:
    campaign = Campaign(id="1" * 32, name="study", state="succeeded", spec={"optimizer": None, "sensitivity": {"map": "m"}})
    nothing = dict.fromkeys(("generations", "solutions", "optima", "influence"), ())
    text = page(findings(results(campaign=campaign, accounting=None, studies=STUDIES[:1]), **nothing), {}, [], "0")
    assert "Recommended after the robustness study: rank 1" in text
    assert "No parameter set" not in text


def test_a_campaign_that_has_just_begun_has_a_report_too(tmp_path: Path) -> None:
    campaign = Campaign(id="1" * 32, name="new", state="queued")
    nothing = dict.fromkeys(("generations", "solutions", "optima", "influence"), ())
    source, files = written(findings(results(campaign=campaign, accounting=None, studies=[]), **nothing), tmp_path)
    assert files == {"tables/generations.csv", "tables/solutions.csv", "campaign.json", "index.html"}
    assert "No parameter set" in source


def test_the_page_says_where_the_map_comes_from() -> None:
    settings = {"design": "lines", "intervals": 5, "samples": 3, "threshold": "auto", "seed": 1}
    basis = {"sensitivity": settings, "runs": 2484, "simulated": 2329}
    blocks = sections.influence_blocks([*ROWS, row("S3", "P1", unknown=True)], basis, [], CAMPAIGN)
    assert "2,484 runs asked for, 2,329 simulated" in str(blocks[0])
    assert rows_of(blocks)[0] == ["P1", "everywhere", "None", "unknown"]
    assert rows_of(blocks)[1][1:3] == ["2 … 7.5", "5 … 10"]


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(InvalidInputError) as refused:
        write(Report(findings(), {}), tmp_path / "file" / "report")
    assert str(tmp_path / "file") in str(refused.value)


def test_the_best_objective_is_described_by_what_it_measures() -> None:
    energy = FirstObjective(name="energy", unit="kWh", direction="minimise")
    assert sections.objective_words(CAMPAIGN) == "0 to 7, higher is better"
    assert sections.objective_words(CAMPAIGN.model_copy(update={"objective": energy})) == "energy, kWh, lower is better"

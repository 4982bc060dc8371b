"""The page and the files beside it."""

from __future__ import annotations

import csv
import json
import re
from collections import Counter
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path

import pytest
from tests.unit.report.rows import ACCOUNT, ROBUST, ROWS, SETUP, findings, row, study

from drivecal.contracts.campaign import Campaign, FirstObjective, Released
from drivecal.contracts.evaluation import FailureCause
from drivecal.contracts.results import Reason, TrustAnswer
from drivecal.domain.errors import InvalidInputError
from drivecal.report.data import ReportData, Studied
from drivecal.report.page import page
from drivecal.report.rows import LOTS_NOTE
from drivecal.report.sections import problem, results, reuse, savings
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


def written(found: ReportData, folder: Path) -> tuple[Reader, set[str]]:
    tables = {"generations": [b"iteration\n", b"0\n"], "solutions": [b"rank\n"]}
    paths = write_report(found, tables, folder)
    assert paths[-1] == folder / "index.html"
    assert all(path.stat().st_size for path in paths)
    return read(paths[-1].read_text()), {path.relative_to(folder).as_posix() for path in paths}


@dataclass(frozen=True)
class Whole:
    """A report of everything, read only."""

    folder: Path
    page: Reader
    files: set[str]

    @property
    def source(self) -> str:
        return (self.folder / "index.html").read_text()

    @property
    def text(self) -> str:
        return "|".join(part.strip() for part in self.page.text if part.strip())


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Whole:
    folder = tmp_path_factory.mktemp("new") / "new" / "report"
    return Whole(folder, *written(findings(), folder))


def test_a_report_has_its_figures_tables_and_page(whole: Whole) -> None:
    page, files = whole.page, whole.files
    names = [
        "9-influence", "9-S1", "9-S2", "10-population", "11-cells", "12-optima", "12-robustness", "14-validation",
    ]  # fmt: skip
    tables = ["generations", "solutions", "robustness-boxes", "accounting", "balance"]
    assert files == {f"figures/figure-{name}.{form}" for name in names for form in ("svg", "png")} | {
        *(f"tables/{name}.csv" for name in tables),
        "campaign.json",
        "index.html",
    }
    assert {link for link in page.links if not link.startswith("#")} == files - {"index.html"}
    assert {link.removeprefix("#") for link in page.links if link.startswith("#")} <= set(page.ids)
    assert (whole.folder / "tables" / "generations.csv").read_bytes() == b"iteration\n0\n"
    assert json.loads((whole.folder / "campaign.json").read_text()) == {"name": "study", "sensitivity": {"intervals": 5}}


def test_the_page_needs_nothing_from_anywhere(whole: Whole) -> None:
    source = whole.source
    assert whole.page.fetched == ["data:,"]
    assert "default-src 'none'" in source
    assert not re.search(r"@import|url\((?!#)|https?://(?!www\.w3\.org/)", source)
    assert "<script" not in source


def test_ids_of_several_drawings_do_not_meet(whole: Whole) -> None:
    page = whole.page
    assert page.ids
    assert [name for name, count in Counter(page.ids).items() if count > 1] == []
    used = set(re.findall(r'(?:url\(|href=")#([^")]+)', whole.source))
    assert used
    assert used <= set(page.ids)


@pytest.mark.slow
def test_what_a_user_wrote_is_shown_and_not_obeyed(tmp_path: Path) -> None:
    page, _ = written(findings(titles={"S1": "<script>alert(1)</script>"}), tmp_path)
    assert "a <b>small</b> study" in page.text
    assert any("not simulated because their weight is 0: S3" in text for text in page.text)


def test_the_page_says_what_the_self_check_found_and_what_it_cost(whole: Whole) -> None:
    for wanted in (
        "|12.50%|52.65%|",
        "|stopped|",
        "It lost 8.4 s.",
        "|net|-8.4|",
        "from 1,800 requested cells on, 23 campaigns",
        "|2 … 7.5|",
    ):
        assert wanted in whole.text
    assert "3 parameter sets share it" in whole.text
    assert "The best set's score in S2 is a reference's" in whole.text


def test_the_page_says_what_certificates_answered_and_what_they_say_of_reused_cells() -> None:
    one = ACCOUNT.scenarios[0].model_copy(update={"certified": 3, "proved": 8, "proved_different": 2, "proved_wrong": 1})
    account = ACCOUNT.model_copy(update={"scenarios": [one, ACCOUNT.scenarios[1]]})
    campaign = findings().campaign
    cells = campaign.cells.model_copy(update={"certified": 1200, "checked": 7})
    found = findings(campaign=campaign.model_copy(update={"stages": {"calibration": cells}}), accounting=account)
    text = re.sub(r"<[^>]+>", "|", "".join(reuse.self_check(found.campaign, account) + results.summary(found)))
    assert "||S1||10||8||2||1||12.50%||" in re.sub(r"\|{2,}", "||", text)
    assert "1,200 cells were answered by certificates" in text
    assert "7 others were simulated all the same to check their certificates" in text
    assert "Certificates say of 8 reused answers what a simulation would have given: 2 have another score, 1 are wrong." in text
    assert reuse.cells_by_stage(found.campaign).count(">7<") == 1
    assert "ertificate" not in "".join(reuse.self_check(campaign, ACCOUNT))


def test_the_page_has_a_table_of_released_lots() -> None:
    campaign = findings().campaign
    assert reuse.lots_table(campaign) == reuse.lots_table(
        campaign.model_copy(update={"released": {"S1": Released(limit=0.05)}})
    )
    cells = campaign.cells.model_copy(update={"predicted": 1333, "sampled": 112})
    released = {
        "S1": Released(
            batches=9,
            asked=8,
            lots=7,
            rejected=1,
            predicted=1333,
            sampled=96,
            different=3,
            limit=0.05,
            upper_95=0.0432,
            seconds=2.5,
        ),
        "S2": Released(lots=1, rejected=1, sampled=16, different=5, limit=0.05),
    }
    campaign = campaign.model_copy(update={"stages": {"calibration": cells}, "released": released})
    text = re.sub(r"(<[^>]+>\s*)+", "|", "".join(reuse.self_check(campaign, None)))
    assert "|S1|8|7|1|1,333|96|3|5.0%|4.32%|" in text
    assert "|S2|0|1|1|0|16|5|5.0%|–|" in text
    assert reuse.cells_by_stage(campaign).count(">1,333<") == reuse.cells_by_stage(campaign).count(">112<") == 1
    assert "1,333" in "".join(results.summary(findings(campaign=campaign)))
    assert LOTS_NOTE not in "".join(reuse.self_check(campaign, None))
    doubtful = {"S1": released["S1"].model_copy(update={"upper_95": 1.0})}
    assert LOTS_NOTE in "".join(reuse.self_check(campaign.model_copy(update={"released": doubtful}), None))


def test_the_page_has_the_light_and_its_reasons() -> None:
    judged = TrustAnswer(
        light="red", reasons=[Reason(light="red", about="confirmation", text="The best set is <not> confirmed.")]
    )
    html = page(findings(trust=judged), {}, [], "0")
    assert "Light: red." in html
    assert "The best set is &lt;not&gt; confirmed." in html
    assert "Light:" not in page(findings(), {}, [], "0")


def test_failed_cells_are_listed_by_cause() -> None:
    causes = [
        FailureCause(
            kind="no_result", cause="crash", detail="x" * 300 + "no licence", scenarios=["S1", "S2"], cells=7, example=12
        ),
        FailureCause(kind="unscored", cause="division by zero", scenarios=["S1"], cells=2, example=3),
    ]
    text = re.sub(r"(<[^>]+>\s*)+", "|", "".join(reuse.failures(causes)))
    assert "|7|no result|crash|..." in text
    assert "no licence|S1 S2|12|" in text
    assert "|2|score without a value|division by zero|" in text
    assert reuse.failures([]) == []


def test_the_page_has_every_part_of_a_study(whole: Whole) -> None:
    for wanted in (
        "3 sets that share the best objective, in 2 distinct regions",
        "In all of them P1 = 1.",
        "The influence map was posted by a user",
        "Recommended: rank 1, because it has the best.",
        "|Sample sizes",
        "|P2|0|5|11|searched|P3|s|0|10|11|held at 4|",
        "Campaign 11111111111111111111111111111111 made this study.",
        "There was nothing to validate in S2.",
        "|S1|f1|d1|S2|f2|–|",
        "|simulator|libsumo 1.28.0|",
        "drivecal submit campaign.json --wait",
        "drivecal evaluate P1=1 P2=2.5 P3=4",
    ):
        assert wanted in whole.text


def test_the_commands_drive_as_the_campaign_did() -> None:
    spec = {
        "catalogue": ["S1"],
        "vehicle": {"model": "hybrid", "parameters": {"mass": 1800.5}},
        "evaluator": "learned",
        "driving_function": "frenet",
    }
    campaign = findings().campaign.model_copy(update={"spec": spec})
    only = SETUP.model_copy(update={"scenarios": SETUP.scenarios[:1]})
    told = "".join(problem.again(findings(campaign=campaign, setup=only, robustness=[Studied(study(vehicle="other"), ROBUST)])))
    options = "--evaluator learned --vehicle {} --vehicle-parameters mass=1800.5 --scenario S1    # the {} set"
    assert options.format("hybrid", "best") in told
    assert options.format("other", "recommended") in told


def test_each_drawing_is_described_and_has_a_table_beside_it(whole: Whole) -> None:
    source = whole.source
    described = re.findall(r'<svg[^>]* role="img" aria-label="([^"]{40,})"', source)
    assert len(described) == source.count("<svg") == 6
    assert len(set(described)) == 6
    wanted = {"Influential bounds", "The course of", "Answers of", "Regions", "Robustness: ", "Deviations in"}
    assert set(re.findall(f"<caption>({'|'.join(sorted(wanted))})", source)) == wanted


def test_nothing_cites_a_figure_or_table_that_the_reader_does_not_have(whole: Whole) -> None:
    assert re.findall(r"\b(?:Figure|Table|Section|Equation) [0-9IVX]+", whole.text) == []


def test_a_campaign_that_only_studies_another_ones_sets_is_not_said_to_have_failed(tmp_path: Path) -> None:
    campaign = Campaign(id="1" * 32, name="study", state="succeeded", spec={"optimizer": None, "sensitivity": {"map": "m"}})
    nothing = dict.fromkeys(("generations", "solutions", "optima", "influence", "validation"), ())
    text = "".join(written(findings(campaign=campaign, accounting=None, basis=None, **nothing), tmp_path)[0].text)
    assert "Recommended after the robustness study: rank 1" in text
    assert "No parameter set" not in text
    assert "iteration (yet)" not in text
    assert "which another database does not have" in text


def test_the_mean_of_all_scenarios_is_that_of_their_runs() -> None:
    first, second = (
        row.model_copy(update={"mean_seconds": mean, "simulated": runs, "simulated_seconds": 99.0})
        for row, mean, runs in zip(ACCOUNT.scenarios, (1.0, 3.0), (10, 30), strict=True)
    )
    *_, total = savings.by_scenario(ACCOUNT.model_copy(update={"scenarios": [first, second]}))
    assert total[savings.FIELDS.index("mean_seconds")] == 2.5


def test_the_account_adds_up_in_its_table(whole: Whole) -> None:
    with (whole.folder / "tables" / "accounting.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["scenario"] for row in rows] == ["S1", "S2", "all"]
    for field in ("requested", "reused", "simulated_seconds"):
        assert float(rows[2][field]) == pytest.approx(sum(float(row[field]) for row in rows[:2]))
    assert float(rows[2]["mean_seconds"]) == pytest.approx(0.02)
    balance = {row[0]: row[1] for row in csv.reader((whole.folder / "tables" / "balance.csv").read_text().splitlines())}
    saved = sum(float(balance[f"saved by {one} cells"]) for one in ("repeated", "reused", "certified"))
    assert float(balance["net"]) == pytest.approx(saved + float(balance["cost of the sensitivity stage"]))


def test_what_predictions_saved_and_the_predictor_cost_is_in_the_balance() -> None:
    account = ACCOUNT.model_copy(update={"savings": {"predicted": 31.0}, "deductions": {"predictor": 7.25}})
    balance = dict(savings.seconds_of(account))
    assert (balance["saved by predicted cells"], balance["cost of the predictor"]) == (31.0, -7.25)


def test_a_campaign_that_has_just_begun_has_a_report_too(tmp_path: Path) -> None:
    campaign = Campaign(id="1" * 32, name="new", state="queued")
    nothing = dict.fromkeys(("generations", "solutions", "optima", "influence", "robustness", "validation"), ())
    page, files = written(findings(campaign=campaign, accounting=None, basis=None, **nothing), tmp_path)
    assert files == {"tables/generations.csv", "tables/solutions.csv", "campaign.json", "index.html"}
    assert any(part.startswith("No parameter set") for part in page.text)


@pytest.mark.slow
def test_the_page_says_where_the_map_comes_from(tmp_path: Path) -> None:
    settings = {"design": "lines", "intervals": 5, "samples": 3, "threshold": "auto", "seed": 1}
    basis = {"sensitivity": settings, "runs": 2484, "simulated": 2329}
    text = "".join(written(findings(basis=basis, influence=[*ROWS, row("S3", "P1", unknown=True)]), tmp_path)[0].text)
    assert "design lines, 5 intervals, 3 samples" in text
    assert "2,484 runs asked for, 2,329 simulated" in text
    assert "probability of about 73%" in text, "three samples miss nine in ten changes of a tenth of the steps"
    assert "unknown" in text


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(InvalidInputError) as refused:
        write_report(findings(), {}, tmp_path / "file" / "report")
    assert str(tmp_path / "file") in str(refused.value)


def test_the_best_objective_is_described_by_what_it_measures() -> None:
    plain = findings().campaign
    energy = FirstObjective(name="energy", unit="kWh", direction="minimise")
    by_score, by_measure = (
        "".join(results.summary(findings(campaign=campaign)))
        for campaign in (plain, plain.model_copy(update={"objective": energy}))
    )
    assert "0 to 7, higher is better" in by_score
    first = by_measure[: by_measure.index("parameter sets share")]
    assert "energy, kWh, lower is better" in first
    assert "0 to 7" not in first

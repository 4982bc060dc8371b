"""Tables and lines of the terminal about a campaign's results."""

from typing import Any

from drivecal.analysis.verdicts import answers, verdict
from drivecal.cli.views import sections
from drivecal.cli.views.sections import Table
from drivecal.contracts.accounting import Accounting, BalanceItem
from drivecal.contracts.campaign import ErrorRate, Released
from drivecal.contracts.evaluation import FailureCause
from drivecal.contracts.results import ResultTrust
from drivecal.contracts.tables import ValidationRow
from drivecal.domain.scales import COMFORT


def rows_of(blocks: Any) -> list[list[str]]:
    return [[str(value) for value in row] for block in blocks if isinstance(block, Table) for row in block.rows]


def test_verdicts_are_listed_below_the_answers_to_their_questions() -> None:
    given = [verdict("failed", "red", error="no memory"), verdict("not_better", "amber")]
    scores, failed, baseline, not_better = sections.trust_blocks(
        ResultTrust(answers=answers(given, ended=True), verdicts=given)
    )
    assert [scores, baseline] == ["Are the scores right? No.", "Is it better than the baseline? Not clearly."]
    assert [failed, not_better] == [f"  {each.light}: {each.text}" for each in given]
    assert sections.trust_blocks(ResultTrust(answers=[], verdicts=[])) == []


def test_an_account_adds_up_in_its_table() -> None:
    balance = [
        BalanceItem(name="reused", label="reused cells", seconds=0.4),
        BalanceItem(name="map", label="analysis", seconds=-9.0),
    ]
    known: dict[str, Any] = {"clock": "cpu", "balance": balance, "net_seconds": -8.6, "sentence": "It lost 8.6 s."}
    account = Accounting.model_construct(None, remarks=[], **known)
    assert rows_of(sections.account_blocks(account)) == [["reused cells", "+0.4"], ["analysis", "-9.0"], ["net", "-8.6"]]
    assert sections.account_blocks(None) == []


def test_checks_are_listed_by_scenario() -> None:
    audits = sections.audits_table(
        {"S1": ErrorRate(audited=8, different=1, wrong=1, upper_95=0.5265), "S2": ErrorRate()}, COMFORT
    )
    assert rows_of(audits) == [["S1", "8", "1", "1", "12.50 %", "52.65 %", "0", "0", "0"]]
    counts = {"asked": 8, "lots": 7, "rejected": 1, "predicted": 1333, "sampled": 96, "different": 3}
    near = Released(**counts, mean_error=1 / 3, largest_error=2.0, limit=0.05, upper_95=0.0432)
    lots = sections.lots_table({"S1": near, "S2": Released(limit=0.05)})
    assert rows_of(lots) == [["S1", "8", "7", "1", "1333", "96", "3", "0.333", "2", "5.0 %", "4.32 %"]]
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


def test_a_validation_has_sample_sizes_and_error_rates() -> None:
    known = ValidationRow(
        scenario="S1", reducible=2, effects=3, covered=3, drawn=40, bases=20, references=5, compared=100, wrong=6, different=10,
        error_rate=0.06, lower_95=0.0, upper_95=0.5, histogram={},
    )  # fmt: skip
    (row,) = rows_of(sections.validation_tables([known], COMFORT))
    assert row == ["S1", "2", "3", "3", "40", "20", "5", "100", "10", "6", "6.00 %", "0.00 %", "50.00 %"]

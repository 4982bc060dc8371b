"""Tables and lines of the terminal about a campaign's results."""

from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from drivecal.analysis.verdicts import answers, verdict
from drivecal.cli.commands.influence import print_influence
from drivecal.cli.commands.serve import doing, remarks
from drivecal.cli.views import sections
from drivecal.cli.views.output import print_blocks
from drivecal.cli.views.sections import Table, front_blocks, front_lines, shown_of_front
from drivecal.contracts.campaign import ErrorRate, Released
from drivecal.contracts.evaluation import FailureCause
from drivecal.contracts.inventory import WaitingAnswer, WorkerAnswer, WorkerPage
from drivecal.contracts.results import Accounting, BalanceItem, FrontBaseline, FrontObjective, FrontSummary, ResultTrust
from drivecal.contracts.tables import FrontRow, InfluenceRow, ValidationRow
from drivecal.domain.scales import COMFORT


def rows_of(blocks: Any) -> list[list[str]]:
    return [[str(value) for value in row] for block in blocks if isinstance(block, Table) for row in block.rows]


def test_verdicts_are_listed_below_the_answers_to_their_questions() -> None:
    given = [verdict("failed", "red", error="no memory"), verdict("not_better", "amber")]
    scores, failed, baseline, no_gain = sections.trust_blocks(ResultTrust(answers=answers(given, ended=True), verdicts=given))
    assert [scores, baseline] == ["Does the result hold? No.", "Is it better than the baseline? Not clearly."]
    assert [failed, no_gain] == [f"  {each.light}: {each.text}" for each in given]
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
    got = sections.audits_table({"S1": ErrorRate(audited=8, different=1, wrong=1, upper_95=0.5265), "S2": ErrorRate()}, COMFORT)
    assert rows_of(got) == [["S1", "8", "1", "1", "12.50 %", "52.65 %", "0", "0", "0", "0"]]
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
            kind="no_result",
            cause="crash",
            detail="timeout" + "x" * 300 + "no licence",
            scenarios=["S1", "S2"],
            cells=7,
            example=12,
        ),
        FailureCause(kind="unscored", cause="division by zero", scenarios=["S1"], cells=2, example=3),
    ]
    (first, second) = rows_of(sections.failures_table(causes))
    assert first[:3] + first[4:] == ["7", "no result", "crash", "S1 S2", "12"]
    assert (first[3][:7], first[3][-10:]) == ("timeout", "no licence")
    assert second[1] == "score without a value"


def test_a_validation_has_sample_sizes_and_error_rates() -> None:
    known = ValidationRow(
        scenario="S1", reducible=2, effects=3, covered=3, drawn=40, bases=20, references=5, compared=100, wrong=6, different=10,
        error_rate=0.06, lower_95=0.0, upper_95=0.5, histogram={},
    )  # fmt: skip
    (row,) = rows_of(sections.validation_tables([known], COMFORT))
    assert row == ["S1", "2", "3", "3", "40", "20", "5", "100", "10", "6", "6.00 %", "0.00 %", "50.00 %"]


def test_the_table_names_what_decided_each_row(capsys: pytest.CaptureFixture[str]) -> None:
    row = InfluenceRow(
        scenario="S1", parameter="P1", influential=True, lower=None, upper=None, s_rel_intervals=[0.2], decided_by="global"
    )
    print_influence([row], None)
    header, line = capsys.readouterr().out.splitlines()[2:4]
    assert (header.split()[-2:], line.split()[-2:]) == (["decided", "by"], ["0.200", "global"])


NOW = datetime(2026, 1, 1, tzinfo=UTC)


def test_a_busy_worker_says_what_it_simulates_and_for_how_long() -> None:
    assert doing(WorkerAnswer(id="w", state="idle"), NOW) is None
    busy = WorkerAnswer(id="w", state="busy", scenario="S3", since=NOW - timedelta(seconds=75))
    assert doing(busy, NOW) == "S3 for 1 min 15 s"
    assert doing(busy, NOW - timedelta(hours=1)) == "S3 for 0 s", "its clock is ahead"


def test_what_a_silent_dispatcher_said_is_marked_as_old() -> None:
    page = WorkerPage(
        items=[WorkerAnswer(id="w", state="busy")],
        dispatcher_seen_at=NOW - timedelta(minutes=3),
        degraded="the dispatcher has been silent for 180 s",
    )
    assert remarks(page, NOW) == [
        "degraded: the dispatcher has been silent for 180 s",
        "this is what the dispatcher said 3 min 00 s ago, before it fell silent",
    ]
    assert remarks(page.model_copy(update={"fresh": True, "degraded": None}), NOW) == []
    waiting = [WaitingAnswer(id="0123456789", name="night", reason="2 of 2 licences are in use")]
    [line] = remarks(WorkerPage(items=[], fresh=True, waiting=waiting), NOW)
    assert all(word in line for word in ("night", "01234567", "2 of 2 licences"))


SIZE, KNEE = 30, 25


def row(rank: int) -> FrontRow:
    ends = {1: ["comfort"], SIZE: ["jerk"]}
    return FrontRow(
        rank=rank, objectives={"comfort": 7 - rank / 10, "jerk": 9 - rank / 10}, violation=0, knee=rank == KNEE,
        best_in=ends.get(rank, []), wins=None, weights=None, alternatives=1, degree=None, scores={"S1": 5}, reused=[],
        parameters={"P1": rank}, iteration=0, individual=rank,
    )  # fmt: skip


ROWS = [row(rank) for rank in range(1, SIZE + 1)]
SUMMARY = FrontSummary(
    objectives=[
        FrontObjective(
            name="jerk", unit="m/s3", direction="minimise", aggregate="max", scenarios={"S1": 1}, tolerance=0, best=6, worst=8.9,
        )
    ],
    constraints=[], evaluated=400, feasible=390, size=SIZE, copied=0, knee=KNEE, growth=[],
)  # fmt: skip


@pytest.mark.parametrize(("limit", "ranks"), [(4, [1, 2, KNEE, SIZE]), (1, [1, KNEE, SIZE]), (99, list(range(1, SIZE + 1)))])
def test_knee_extremes_and_the_first_others_are_shown(limit: int, ranks: list[int]) -> None:
    assert [kept.rank for kept in shown_of_front(ROWS, limit)] == ranks


def test_as_many_sets_are_listed_as_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    print_blocks(front_blocks(ROWS, SUMMARY, 4))
    printed = capsys.readouterr().out
    assert [int(line.split()[0]) for line in printed.splitlines()[-4:]] == [1, 2, KNEE, SIZE]
    assert f"4 of {SIZE}" in printed


def test_a_baseline_with_undecided_rates_breaks_nothing_by_a_figure() -> None:
    undecided = FrontBaseline(objectives={"jerk": 7}, violation=0.0009, undecided=True, rank=None)
    (line,) = (line for line in front_lines(SUMMARY.model_copy(update={"baseline": undecided})) if line.startswith("baseline"))
    assert "%" not in line

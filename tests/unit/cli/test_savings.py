"""What is printed below a campaign: errors of reuse, what was narrowed, the balance."""

from __future__ import annotations

import pytest
from tests.unit.report.rows import ACCOUNT

from drivecal.cli.views.savings import (
    break_even_text,
    pays_text,
    print_accounting,
    print_error_rates,
    print_lots,
    print_narrowed,
)
from drivecal.contracts.accounting import BreakEven, MapCost
from drivecal.contracts.campaign import ErrorRate, Narrowed, Released


def test_error_rates_have_their_bound_and_say_where_reuse_was_stopped(capsys: pytest.CaptureFixture[str]) -> None:
    rates = {
        "S1": ErrorRate(audited=200, different=9, wrong=3, upper_95=0.0432, stopped=True, contradictions=2, lots=7, rejected=4),
        "S2": ErrorRate(),
        "S3": ErrorRate(contradictions=1),
    }
    print_error_rates(rates)
    lines = capsys.readouterr().out.splitlines()
    assert lines[3].split() == ["S1", "200", "9", "3", "1.50%", "4.32%", "2", "7", "4", "stopped"]
    assert lines[4].split() == ["S3", "0", "0", "0", "-", "-", "1", "0", "0", "on"]
    assert len(lines) == 5


def test_lots_have_a_row_by_scenario(capsys: pytest.CaptureFixture[str]) -> None:
    print_lots(
        {
            "S1": Released(lots=7, rejected=1, predicted=1200, sampled=96, different=3, limit=0.05, upper_95=0.0432),
            "S2": Released(lots=1, rejected=1, sampled=16, different=5, limit=0.05),
            "S3": Released(limit=0.05, seconds=1.5),
        }
    )
    lines = capsys.readouterr().out.splitlines()
    assert lines[3].split() == ["S1", "0", "7", "1", "1200", "96", "3", "5.0%", "4.32%"]
    assert lines[4].split() == ["S2", "0", "1", "1", "0", "16", "5", "5.0%", "-"]
    assert len(lines) == 5, "a scenario without a lot has no row"


def test_what_predictions_saved_and_the_predictor_took_is_in_the_balance(capsys: pytest.CaptureFixture[str]) -> None:
    print_accounting(ACCOUNT.model_copy(update={"savings": {"predicted": 31.0}, "deductions": {"predictor": 7.25}}))
    signed = [line.split()[-3:] for line in capsys.readouterr().out.splitlines() if line.endswith(" s")]
    assert ["+", "31.0", "s"] in signed
    assert ["-", "7.2", "s"] in signed


def test_nothing_is_printed_where_nothing_was_checked_or_narrowed(capsys: pytest.CaptureFixture[str]) -> None:
    print_error_rates({"S1": ErrorRate()})
    print_lots({})
    print_lots({"S1": Released(limit=0.05)})
    print_narrowed(None)
    print_narrowed([])
    assert capsys.readouterr().out == ""


def test_the_balance_says_what_was_saved_what_it_cost_and_what_is_left(capsys: pytest.CaptureFixture[str]) -> None:
    print_accounting(ACCOUNT)
    printed = capsys.readouterr().out
    assert [line.split()[-3:] for line in printed.splitlines() if line.endswith(" s")] == [
        ["+", "0.2", "s"],
        ["+", "0.4", "s"],
        ["-", "9.0", "s"],
        ["-", "8.4", "s"],
    ]
    assert "certificates" not in printed, "what never happened needs no line"
    assert " 8 reusable cells in 0.2 s" in printed
    assert printed.endswith("from 23 such campaigns on\nIt lost 8.4 s.\n")


def test_what_certificates_say_of_references_is_told_by_scenario(capsys: pytest.CaptureFixture[str]) -> None:
    first, *others = ACCOUNT.scenarios
    proved = first.model_copy(update={"proved": 1200, "proved_different": 30, "proved_wrong": 2})
    print_accounting(ACCOUNT.model_copy(update={"scenarios": [proved, *others]}))
    assert f"{first.scenario} 30 of 1,200, 2" in capsys.readouterr().out


def test_reused_cells_that_were_confirmed_are_told_for_they_saved_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    first, *others = ACCOUNT.scenarios
    print_accounting(ACCOUNT.model_copy(update={"scenarios": [first.model_copy(update={"confirmed": 3}), *others]}))
    assert "3 copied or predicted scores " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("made_by", "runs", "expected"),
    [
        ("f" * 32, 450, f"paid by campaign {'f' * 32} (450 runs, 2 min 05 s)"),
        (None, 0, "the influence map is expert knowledge\n"),
    ],
)
def test_a_map_that_was_paid_elsewhere_is_said_to_be(
    capsys: pytest.CaptureFixture[str], made_by: str | None, runs: int, expected: str
) -> None:
    paid = MapCost(id="0" * 32, made_by=made_by, paid_here=False, runs=runs, seconds=125.0)
    print_accounting(ACCOUNT.model_copy(update={"map": paid}))
    assert expected in capsys.readouterr().out


def test_when_the_map_pays() -> None:
    assert break_even_text(BreakEven(requested_cells=1800, campaigns=1, reruns=0)).endswith(
        "1,800 requested cells on, that is from 1 such campaign on"
    )
    assert "never" in break_even_text(BreakEven(requested_cells=None, campaigns=None, reruns=None))
    assert "12.5% of the requested cells" in pays_text(0.125)
    assert "cannot pay within this campaign" in pays_text(1.2)


def test_what_was_narrowed_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    print_narrowed([Narrowed(parameter="P1", lower=-5, upper=14, full_lower=-15, full_upper=14, values=59, removed_values=20)])
    assert capsys.readouterr().out.splitlines()[-1].split() == ["P1", "-5", "14", "-15", "14", "20", "59"]

"""The review sheet from plain data: its content, its digest, and what verification finds."""

import html
import re
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.unit.report.rows import CAMPAIGN, results

from drivecal.analysis.verdicts import verdict
from drivecal.contracts.campaign import Baseline, Released, Study
from drivecal.contracts.results import FrontBaseline, FrontObjective, FrontSummary, ResultTrust, StudyResult
from drivecal.contracts.tables import BoxTrial, FrontRow, RobustnessRow, Solution
from drivecal.domain.errors import InvalidInputError
from drivecal.report.data import Review, ReviewedSet, ScoreOrigin
from drivecal.report.review import sheet
from drivecal.report.sheet import differences, digest_of, read_sheet

CHOSEN = {"P1": 0.1 + 0.2, "P2": 2.5, "P3": 4.0}


def goal(name: str = "comfort", direction: str = "maximise", **given: Any) -> FrontObjective:
    known: dict[str, Any] = {
        "unit": "points", "aggregate": "mean", "scenarios": {"S1": 0.75, "S2": 0.25}, "tolerance": 0.5, "reference": 0.0, "best": 6.0,
        "worst": 1.0,
    }  # fmt: skip
    return FrontObjective(**{"name": name, "direction": direction, **known, **given})


def summary(*goals: FrontObjective) -> FrontSummary:
    return FrontSummary(
        objectives=list(goals or [goal()]), constraints=["max of gap <= 3 (S1, S2)"], evaluated=40, feasible=38, size=3, copied=0, knee=2,
        hypervolume=4.25, growth=[],
    )  # fmt: skip


def front_row(rank: int, comfort: float, jerk: float, **given: Any) -> FrontRow:
    known: dict[str, Any] = {
        "violation": 0.0, "knee": rank == 2, "best_in": [], "wins": None, "weights": None, "alternatives": 1, "degree": None,
        "scores": {"S1": 6, "S2": 5}, "reused": [], "parameters": CHOSEN, "iteration": 1, "individual": rank,
    }  # fmt: skip
    return FrontRow(**{"rank": rank, "objectives": {"comfort": comfort, "jerk": jerk}, **known, **given})


def robust(parameters: dict[str, Any]) -> StudyResult:
    settings = {"delta": 0.01, "samples": 30, "condition": "max", "eta": 1.0}
    study = Study(
        campaign="c" * 32, name="study", stage="robustness", state="succeeded", settings=settings, vehicle="hybrid",
        ended_at=None,
    )  # fmt: skip
    trial = BoxTrial(box=1, radius=0.01, holds=True, deviations={"S1": 0.0, "S2": 0.5})
    row = RobustnessRow(
        rank=1, objective=5.7, rating=5.7, degree=7, at_least=False, radius=0.07, recommended=True, reason="the largest degree", region=1,
        to_worse=None, scores={"S1": 6, "S2": 5}, parameters=parameters, trials=[trial],
    )  # fmt: skip
    return StudyResult(study=study, robustness=[row])


def reviewed(identifier: str = "a" * 32, **given: Any) -> ReviewedSet:
    baseline = Baseline(objective=4.75, parameters={"P1": -1.0, "P2": 1.0, "P3": 4.0}, scores={"S1": 5, "S2": 4})
    released = {"S2": Released(lots=4, rejected=1, predicted=90, sampled=30, different=2, limit=0.05, upper_95=0.034)}
    solution = Solution(
        rank=1, objective=5.75, rating=5.7, scores={"S1": 6, "S2": 5}, reused=["S2"], parameters=CHOSEN, iteration=1,
        individual=3,
    )  # fmt: skip
    known: dict[str, Any] = {
        "campaign": CAMPAIGN.model_copy(update={"id": identifier, "baseline": baseline, "released": released}),
        "accounting": None,
        "trust": ResultTrust(
            light="amber", verdicts=[verdict("not_better", "amber"), verdict("scores_copied", "amber", scenarios=["S2"])]
        ),
        "studies": [robust(CHOSEN)],
    }
    found = results(**known | {name: given.pop(name) for name in list(given) if name in {*known, "setup"}})
    rest: dict[str, Any] = {
        "results": found,
        "table": "solutions",
        "chosen": solution,
        "cells": {"S1": ScoreOrigin(11, "simulated"), "S2": ScoreOrigin(12, "reused")},
        "summary": summary(),
    }
    return ReviewedSet(**rest | given)


def with_campaign(known: ReviewedSet, **changed: Any) -> ReviewedSet:
    campaign = known.results.campaign.model_copy(update=changed)
    return replace(known, results=known.results.model_copy(update={"campaign": campaign}))


def compromise(identifier: str = "a" * 32, rank: int = 1, **given: Any) -> ReviewedSet:
    rows = [front_row(1, 6.0, 5.0), front_row(2, 5.0, 3.0), front_row(3, 1.0, 2.5)]
    two = summary(goal(), goal("jerk", "minimise", unit="m/s^3"))
    return reviewed(identifier, table="front", chosen=rows[rank - 1], front=rows, summary=two, **given)


def review(*sets: ReviewedSet) -> Review:
    named = {"chosen": sets[0]} if len(sets) == 1 else dict(zip(("A", "B"), sets, strict=True))
    return Review(named, f"/campaigns/{sets[0].id}/review?set=1", "1.2.3")


PAGE = sheet(review(reviewed()))
BOTH = sheet(review(compromise(), compromise("b" * 32, 2)))


def text_of(page: str) -> str:
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", page)).split())


def test_the_sheet_shows_values_results_origins_and_confidence() -> None:
    text = text_of(PAGE)
    for expected in (
        "0.30000000000000004 ",  # all digits
        "held at 4",
        "-10 to 10, 21 values",
        "comfort 4.75 5.75 +1",
        "S1 5 6 +1 simulated (11)",
        "S2 4 5 +1 copied (12)",
        "Subject to max of gap <= 3 (S1, S2).",
        "Light: amber.",
        "amber: No set is better than the baseline.",
        "S2 0 4 1 90 30 2 5.0% 3.40%",
        "degree of robustness 7",
        "was not simulated in S2",
    ):
        assert expected in text


def test_every_table_is_followed_by_its_command() -> None:
    body = PAGE[PAGE.index("<section") : PAGE.index('id="section-signatures"')]
    parts = re.findall(r"<table>|<p class=\"command\">", body)
    assert parts.count("<table>") > 6
    assert all(after == '<p class="command">' for part, after in zip(parts, [*parts[1:], ""], strict=True) if part == "<table>")


def test_two_sets_stand_beside_each_other() -> None:
    text = text_of(BOTH)
    assert "jerk – 5 3 -2" in text
    assert "comfort 4.75 6 5 -1" in text
    assert BOTH.count("<svg") == 2
    assert "chosen" in text


def test_the_baseline_of_every_objective_is_shown() -> None:
    judged = FrontBaseline(objectives={"comfort": 4.75, "jerk": 4.5}, violation=0.0, rank=None)
    subject = compromise()
    known = replace(subject, summary=subject.summary.model_copy(update={"baseline": judged}))
    text = text_of(sheet(review(known)))
    assert "comfort 4.75 6 +1.25" in text
    assert "jerk 4.5 5 +0.5" in text


def test_a_score_that_another_campaign_simulated_later_names_its_cell() -> None:
    cells = {"S1": ScoreOrigin(11, "simulated"), "S2": ScoreOrigin(2031, "later", "d" * 32)}
    page = text_of(sheet(review(reviewed(cells=cells))))
    assert "S2 4 5 +1 simulated later (2031 of campaign dddddddd)" in page
    assert f"for cell in 11; do drivecal explain {'a' * 32} $cell; done" in page
    assert f"for cell in 2031; do drivecal explain {'d' * 32} $cell; done" in page


def test_the_sheet_needs_nothing_else() -> None:
    for page in (PAGE, BOTH):
        assert "<script" not in page
        assert not re.search(r"(src|href)=\"(?!#|data:)", page)
        assert not re.search(r"url\((?!#)", page)


def test_equal_results_give_equal_bytes_and_the_digest_is_that_of_the_content() -> None:
    again = read_sheet(sheet(review(reviewed())), "again.html")
    assert again.is_unchanged
    assert again.digest in PAGE
    assert digest_of(PAGE.replace(again.digest, "0" * 64)) == again.digest
    assert (again.campaign, again.query, again.version) == ("a" * 32, {"set": "1"}, "1.2.3")


def test_a_changed_number_is_found_and_named() -> None:
    changed = PAGE.replace(">11.", ">12.").replace('<td class="n">5.75</td>', '<td class="n">6.75</td>')
    assert not read_sheet(changed, "changed.html").is_unchanged
    [difference] = differences(changed, PAGE)
    assert (difference.place, difference.first, difference.second) == ("Result, comfort, chosen", "6.75", "5.75")


def test_a_later_result_of_the_campaign_is_found_and_named() -> None:
    later = sheet(review(reviewed(studies=[])))
    assert read_sheet(later, "later.html").is_unchanged
    places = {difference.place for difference in differences(PAGE, later)}
    assert "Robustness, degree of robustness, value" in places
    assert not any(place.startswith(("Result", "Parameters", "Question")) for place in places)


def test_a_new_digest_does_not_hide_a_change() -> None:
    forged = PAGE.replace("Light: amber.", "Light: green.")
    old = read_sheet(forged, "forged.html").digest
    forged = forged.replace(old, digest_of(forged.replace(old, "0" * 64)))
    assert read_sheet(forged, "forged.html").is_unchanged
    assert [difference.second for difference in differences(forged, PAGE)] == ["Light: amber."]


CELLS = [match.span(1) for match in re.finditer(r"<td[^>]*>([^<]+)</td>", PAGE)]


@settings(max_examples=10)
@given(st.sampled_from(CELLS), st.text("0123456789.-", min_size=1, max_size=6))
def test_any_other_text_of_a_cell_is_found(span: tuple[int, int], text: str) -> None:
    changed = PAGE[: span[0]] + text + PAGE[span[1] :]
    known = PAGE[slice(*span)]
    found = [each for each in differences(changed, PAGE) if each.first == text]
    assert (len(found) > 0) == (html.unescape(known) != text)


@pytest.mark.parametrize(
    "text", ["", "<html></html>", PAGE.replace("drivecal-review", "other"), PAGE.replace("/campaigns/", "/elsewhere/")]
)
def test_another_file_is_refused(text: str) -> None:
    with pytest.raises(InvalidInputError, match=r"other\.html"):
        read_sheet(text, "other.html")


def test_an_unfinished_campaign_gives_a_draft() -> None:
    running = reviewed()
    running = with_campaign(running, state="running", ended_at=None)
    assert "Draft: campaign" in text_of(sheet(review(running)))
    assert "Draft" not in PAGE


def test_names_of_users_are_text_and_no_markup() -> None:
    named = reviewed()
    named = with_campaign(named, name="<b>x</b></style><script>")
    page = sheet(review(named))
    assert "<script" not in page
    assert read_sheet(page, "x.html").is_unchanged

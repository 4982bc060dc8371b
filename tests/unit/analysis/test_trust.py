"""The light of a campaign's result, and the reasons for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
from tests.support.scales import COST

from drivecal.analysis.better_sets import Earlier, Later
from drivecal.analysis.chosen import BesideBaseline, Chosen
from drivecal.analysis.confirmation import CONFIRMED, NOT_CONFIRMED, UNTRIED
from drivecal.analysis.trust import Compromises, Driven, Search, Validated, trust
from drivecal.contracts.campaign import Baseline, Best, Campaign, CellCounts, ErrorRate, FirstObjective, Released
from drivecal.contracts.tables import RobustnessRow, ValidationRow

BEST = Best(objective=6.0, parameters={"P1": 0.5}, scores={"S1": 6}, alternatives=1)
LOTS = {"S1": ErrorRate(lots=3)}
NEAR = Released(limit=0.05, lots=4, rejected=1, inspected=400, predicted=300, sampled=40, different=3)


def campaign(mode: str = "both", *, cells: dict[str, int] | None = None, **given: Any) -> Campaign:
    known: dict[str, Any] = {"id": "c", "name": "a campaign", "state": "succeeded", "best": BEST}
    reduction = {"mode": mode, **given.pop("reduction", {})}
    spec = {"optimizer": {"kind": "genetic"}, "reduction": reduction}
    counts = CellCounts(**{"proposed": 100, "requested": 100, "reused": 20, "simulated": 80, **(cells or {})})
    return Campaign(**{**known, "spec": spec, "stages": {"calibration": counts}, **given})


def validation(error_rate: float, lower: float, scenario: str = "S1", **given: Any) -> ValidationRow:
    counts = dict.fromkeys(("reducible", "effects", "covered", "drawn", "references"), 1)
    known: dict[str, Any] = {"bases": 100, "compared": 100, "wrong": 0, "different": 0, "upper_95": 1.0, "histogram": {}}
    return ValidationRow(**{"scenario": scenario, "error_rate": error_rate, "lower_95": lower, **counts, **known, **given})


def robust(degree: int) -> RobustnessRow:
    return RobustnessRow(
        rank=1, objective=6.0, rating=6.0, degree=degree, at_least=False, radius=0.01 * degree, recommended=True, reason="the best",
        region=0, to_worse=None, scores={}, parameters={}, trials=[],
    )  # fmt: skip


def lights(subject: Campaign, *rows: ValidationRow, driven: Sequence[RobustnessRow] = ()) -> dict[tuple[str, str | None], str]:
    """The lights of all reasons, by what they are about."""
    judged = trust(subject, [Validated("v" * 32, rows)], [Driven("d", driven)])
    return {(reason.about, reason.scenario): reason.light for reason in judged.reasons}


def test_a_confirmed_best_set_and_inspected_lots_are_green() -> None:
    judged = trust(campaign("predicted", notes=[f"{CONFIRMED}: 1 set tried"], released={"S1": NEAR}))
    assert judged.light == "green"
    assert [reason.about for reason in judged.reasons] == ["confirmation", "predictions"]
    assert "1 lot had too many errors" in judged.reasons[1].text


def test_a_best_set_without_confirmation_is_red() -> None:
    judged = trust(campaign(notes=[f"{NOT_CONFIRMED}: the score in S4 is a reference's"]))
    assert (judged.light, judged.reasons[0].about) == ("red", "confirmation")
    assert "S4" in judged.reasons[0].text


def test_a_best_set_that_nobody_asked_to_confirm_is_amber_if_cells_were_reused() -> None:
    assert lights(campaign("predicted", reduction={"confirm": 0})) == {("confirmation", None): "amber"}
    assert lights(campaign(reduction={"confirm": 0}, cells={"reused": 0})) == {("confirmation", None): "green"}


@pytest.mark.parametrize(
    ("max_error", "rate", "lower", "light"),
    [(0.02, 0.211, 0.15, "amber"), (1.0, 0.211, 0.15, "red"), (1.0, 0.03, 0.01, "amber"), (0.02, 0.01, 0.0, "green")],
)
def test_a_wrong_map_is_amber_behind_lots_and_red_without_them(max_error: float, rate: float, lower: float, light: str) -> None:
    lots = {} if max_error == 1 else LOTS
    subject = campaign(reduction={"max_error": max_error}, notes=[f"{CONFIRMED}: 1 set tried"], error_rate=lots)
    judged = trust(subject, [Validated("v" * 32, [validation(rate, lower)])])
    assert judged.light == light
    (about_the_map,) = (reason for reason in judged.reasons if reason.about == "map")
    assert about_the_map.light == light
    assert f"{rate:.1%}" in about_the_map.text


def test_the_newest_validation_of_a_scenario_counts() -> None:
    subject = campaign(notes=[f"{CONFIRMED}: 1 set tried"])
    subject = subject.model_copy(update={"error_rate": LOTS})
    newest = Validated("n", [validation(0.0, 0.0, "S1")])
    older = Validated("o", [validation(0.5, 0.4, "S1"), validation(0.3, 0.2, "S2")])
    (wrong,) = (reason for reason in trust(subject, [newest, older]).reasons if reason.about == "map")
    assert (wrong.scenario, wrong.light) == ("S2", "amber")


def test_scenarios_with_the_same_fault_share_a_reason() -> None:
    rates = {**LOTS, "S5": ErrorRate(contradictions=3), "S6": ErrorRate(contradictions=12)}
    subject = campaign(notes=[f"{CONFIRMED}: 1 set tried"], error_rate=rates)
    study = Validated("v" * 32, [validation(0.3, 0.2, "S1"), validation(0.075, 0.0, "S2"), validation(0.0, 0.0, "S3")])
    amber = [reason for reason in trust(subject, [study]).reasons if reason.light == "amber"]
    assert [(reason.about, reason.scenario) for reason in amber] == [("map", None), ("references", None)]
    assert "30.0% in S1 and 7.5% in S2" in amber[0].text
    assert "3 in S5 and 12 in S6" in amber[1].text


def test_a_wrong_map_does_not_matter_to_a_campaign_that_uses_none() -> None:
    assert ("map", "S1") not in lights(campaign("exact"), validation(0.5, 0.4))
    assert ("map", None) not in lights(campaign("predicted"), validation(0.0, 0.0))


def test_reuse_without_lots_and_without_a_validation_is_amber() -> None:
    subject = campaign(reduction={"max_error": 1}, notes=[f"{CONFIRMED}: 1 set tried"])
    assert lights(subject)["map", None] == "amber"


def test_audits_stops_and_contradictions_name_their_scenario() -> None:
    rates = {
        "S1": ErrorRate(audited=20, wrong=5, stopped=True),
        "S2": ErrorRate(audited=100, wrong=1),
        "S3": ErrorRate(audited=100, wrong=10),
        "S4": ErrorRate(contradictions=3),
    }
    judged = lights(campaign(reduction={"max_error": 1}, error_rate=rates))
    expected = {"S1": "amber", "S2": "amber", "S3": "red", "S4": "amber"}
    assert {scenario: light for (about, scenario), light in judged.items() if about == "references"} == expected
    assert ("references", "S2") not in lights(campaign(error_rate={"S2": rates["S2"], **LOTS})), "lots inspect these"


def test_answers_of_a_release_without_lots_were_not_inspected() -> None:
    """It had a limit by default, after which it stopped reuse."""
    assert lights(campaign(error_rate={"S3": ErrorRate(audited=100, wrong=10)}))["references", "S3"] == "red"
    assert lights(campaign())["map", None] == "amber"


@pytest.mark.parametrize(("beyond", "lower", "light"), [(2, 0.0, "green"), (12, 0.04, "amber"), (30, 0.2, "red")])
def test_validated_predictions_are_held_against_their_limit(beyond: int, lower: float, light: str) -> None:
    known: dict[str, Any] = {"released": 300, "inspected": 400, "beyond": beyond, "limit": 0.05}
    row = validation(0.0, 0.0, beyond_lower_95=lower, **known)
    assert lights(campaign("predicted"), row)["predictions", "S1"] == light
    off_by_what_is_allowed = validation(0.9, 0.8, **known | {"beyond": 0})
    assert lights(campaign("predicted"), off_by_what_is_allowed)["predictions", "S1"] == "green"


def test_a_better_set_that_was_not_tried_is_amber() -> None:
    assert trust(campaign("predicted", notes=[f"{UNTRIED}: 7 is believed"])).light == "amber"


def test_noise_and_failures_are_told() -> None:
    judged = lights(campaign(cells={"failed": 5, "unscored": 1, "unrepeatable": 2}))
    assert judged["noise", None] == "amber"
    assert lights(campaign(cells={"failed": 5}))["failures", None] == "amber"
    assert lights(campaign(cells={"failed": 1}))["failures", None] == "green"


def test_scores_that_were_cut_off_are_told_if_they_matter() -> None:
    assert ("cut", None) not in lights(campaign())
    assert lights(campaign(cells={"cut": 1}))["cut", None] == "green"
    assert lights(campaign(cells={"cut": 2}))["cut", None] == "amber"
    worst = BEST.model_copy(update={"scores": {"S1": COST.failed, "S2": 3.0}})
    [reason] = [reason for reason in trust(campaign(cells={"cut": 1}, best=worst, scale=COST)).reasons if reason.about == "cut"]
    assert (reason.light, "S1" in reason.text, "`failed`" in reason.text) == ("amber", True, True)
    assert reason.text.startswith("1 score (")


@pytest.mark.parametrize(("objective", "light"), [(4.0, "green"), (6.0, "amber"), (7.0, "amber")])
def test_the_best_set_is_held_against_the_baseline(objective: float, light: str) -> None:
    before = Baseline(objective=objective, parameters={}, scores={})
    assert lights(campaign(baseline=before))["baseline", None] == light
    opposite = {4.0: "amber", 6.0: "amber", 7.0: "neutral"}  # its tolerance is 2
    assert lights(campaign(baseline=before, scale=COST))["baseline", None] == opposite[objective]


def test_a_gain_within_the_tolerance_speaks_neither_for_nor_against_a_result() -> None:
    before = Baseline(objective=5.5, parameters={}, scores={})
    judged = trust(campaign("exact", cells={"reused": 0}, baseline=before))
    [reason] = [reason for reason in judged.reasons if reason.about == "baseline"]
    assert (reason.light, judged.light) == ("neutral", "green")
    assert reason.text.endswith("by 0.5, within the tolerance of 1 point.")


@pytest.mark.parametrize(("objective", "light"), [(4.0, "amber"), (6.0, "amber"), (7.0, "green")])
def test_the_first_objective_says_which_direction_is_better(objective: float, light: str) -> None:
    first = FirstObjective(name="jerk", unit="m/s^3", direction="minimise")
    before = Baseline(objective=objective, parameters={}, scores={})
    assert lights(campaign(baseline=before, objective=first))["baseline", None] == light


def test_a_best_set_that_breaks_constraints_is_red() -> None:
    broken = BEST.model_copy(update={"violation": 0.1})
    judged = trust(campaign("exact", cells={"reused": 0}, best=broken))
    assert (judged.light, judged.reasons[0].about) == ("red", "constraints")


def test_a_baseline_that_breaks_constraints_is_worse_than_one_that_keeps_them() -> None:
    before = Baseline(objective=7.0, parameters={}, scores={}, violation=0.1)
    assert lights(campaign(baseline=before))["baseline", None] == "green"


def test_a_search_that_ended_without_a_doubtful_set_has_a_light() -> None:
    judged = trust(campaign("predicted"))
    assert ("confirmation", None) in {(reason.about, reason.scenario) for reason in judged.reasons if reason.light == "green"}


def test_a_robustness_study_says_how_far_the_recommended_set_holds() -> None:
    assert lights(campaign(), driven=[robust(0)])["robustness", None] == "amber"
    assert lights(campaign(), driven=[robust(3)])["robustness", None] == "green"


@pytest.mark.parametrize(
    ("state", "best", "light"),
    [
        ("failed", BEST, "red"),
        ("succeeded", None, "red"),
        ("cancelled", BEST, "amber"),
        ("running", BEST, None),
        ("queued", None, None),
    ],
)
def test_the_end_of_a_campaign_decides_first(state: str, best: Best | None, light: str | None) -> None:
    assert trust(campaign("exact", cells={"reused": 0}, state=state, best=best, error="out of memory")).light == light


def test_what_searches_nothing_has_no_light() -> None:
    assert trust(campaign().model_copy(update={"spec": {"optimizer": None}})).light is None


@pytest.mark.parametrize(
    ("objective", "given", "is_told"),
    [
        (6.5, {}, True),
        (6.0, {}, False),
        (5.5, {}, False),
        (5.5, {"scale": COST}, True),
        (6.5, {"scale": COST}, False),
        (6.5, {"state": "running"}, False),
        (6.5, {"best": None}, False),
    ],
)
def test_a_better_set_of_the_campaign_that_is_rerun_is_told(objective: float, given: dict[str, Any], is_told: bool) -> None:
    judged = trust(campaign(**given), earlier=Earlier("e" * 32, objective, {"S1": 4.0, "S2": 1.0}))
    reasons = [reason for reason in judged.reasons if reason.about == "earlier"]
    assert [reason.light for reason in reasons] == ["amber"] * is_told
    assert all("solutions eeeeeeee --weights S1=4,S2=1" in reason.text for reason in reasons)


@pytest.mark.parametrize(("objective", "is_better"), [(None, False), (6.0, False), (6.5, True)])
def test_a_rerun_of_a_pruned_campaign_is_never_green(objective: float | None, is_better: bool) -> None:
    judged = trust(campaign(), earlier=Earlier("e" * 32, objective, {"S1": 4.0}, is_pruned=True))
    [reason] = [reason for reason in judged.reasons if reason.about == "earlier"]
    assert (judged.light, reason.light) == ("amber", "amber")
    assert ("solutions eeeeeeee" in reason.text) is is_better


@pytest.mark.parametrize(
    ("objective", "direction", "is_told"), [(6.5, "maximise", True), (6.5, "minimise", False), (5.5, "minimise", True)]
)
def test_a_better_set_under_objectives_of_the_rerun_is_told(objective: float, direction: Any, is_told: bool) -> None:
    first = FirstObjective(name="energy", unit="1", direction=direction)
    judged = trust(campaign(objective=first), earlier=Earlier("e" * 32, objective, {"S1": 1.0}))
    assert [reason.light for reason in judged.reasons if reason.about == "earlier"] == ["amber"] * is_told


@pytest.mark.parametrize(("gain", "words"), [(0.5, "a better set"), (-0.5, "the best set is worse"), (0.0, None)])
def test_later_simulations_that_change_the_best_set_are_amber(gain: float, words: str | None) -> None:
    later = Later(6.0 + gain, gain, {"P1": 0.7}, ["f" * 32])
    told = [reason for reason in trust(campaign(), later=later).reasons if reason.about == "later"]
    assert [reason.light for reason in told] == ["amber"] * (words is not None)
    assert all(words in reason.text and "campaign ffffffff" in reason.text for reason in told if words is not None)


def test_a_chosen_set_that_became_the_best_is_named_as_such() -> None:
    later = Later(6.5, 0.5, {"P1": 0.7})
    assert "the chosen set is the best" in about_the_set(Chosen({"P1": 0.7}), later=later)["later"][1]
    assert "a better set" in about_the_set(Chosen({"P1": 0.9}), later=later)["later"][1]


def about_the_search(subject: Campaign, search: Search) -> list[tuple[str, str]]:
    return [(reason.light, reason.text) for reason in trust(subject, search=search).reasons if reason.about == "search"]


@pytest.mark.parametrize(
    ("course", "given", "lights"),
    [
        ([(6.0, 6.2)] * 3, {}, ["amber"]),
        ([(6.0, None)] * 3, {}, ["amber"]),
        ([(6.0, 6.2)] * 2, {}, []),
        ([(5.5, 6.2), (6.0, 6.2), (6.0, 6.2)], {}, []),
        ([(6.0, 6.2), (6.0, 6.2), (6.0, 6.3)], {}, []),
        ([(5.5, 6.2)] * 3, {}, []),
        ([(None, None)] * 3, {}, []),
        ([(6.0, 6.2)] * 3, {"state": "cancelled"}, []),
        ([(6.0, 6.2)] * 3, {"best": None}, []),
        ([], {}, []),
    ],
)
def test_a_search_that_its_first_iteration_decided_is_amber(
    course: list[tuple[float | None, float | None]], given: dict[str, Any], lights: list[str]
) -> None:
    assert [light for light, _ in about_the_search(campaign(**given), Search(course, {}))] == lights


@pytest.mark.parametrize(
    ("requested", "grid", "lights"),
    [(54, 54, ["green"]), (48, 54, ["green"]), (30, 54, ["amber", "green"]), (900, 10**400, ["amber", "green"])],
)
def test_a_search_that_asked_for_nearly_all_sets_missed_little(requested: int, grid: int, lights: list[str]) -> None:
    stalled = Search([(6.0, 6.0)] * 5, {}, requested, grid)
    about = about_the_search(campaign(), stalled)
    assert [light for light, _ in about] == lights
    assert f"{requested:,}" in about[-1][1]


@pytest.mark.parametrize(("objective", "scale", "is_doubted"), [(7.0, {}, False), (7.0, {"scale": COST}, True)])
def test_the_highest_score_in_steps_is_not_doubted(objective: float, scale: dict[str, Any], is_doubted: bool) -> None:
    subject = campaign(best=BEST.model_copy(update={"objective": objective}), **scale)
    assert bool(about_the_search(subject, Search([(objective, None)] * 5, {}))) is is_doubted


def test_values_at_an_end_of_their_range_are_named() -> None:
    best = BEST.model_copy(update={"parameters": {"P1": 0.5, "P2": 3.0, "P3": 1.0, "mode": "eco"}})
    ranges = {"P1": (0.5, 2.0), "P2": (1.0, 3.0), "P3": (0.0, 2.0)}
    ((light, text),) = about_the_search(campaign(best=best), Search([(6.0, None), (6.0, None)], ranges))
    assert light == "green"
    assert [name for name in (*ranges, "mode") if f"{name} (" in text] == ["P1", "P2"]
    assert about_the_search(campaign(best=best), Search([], {"P3": (0.0, 2.0)})) == []


ENERGY = BesideBaseline("energy", 153.8, 153.2, -1)
COMFORT = BesideBaseline("comfort", 6.0, 4.0, 1)


def about_the_set(chosen: Chosen, later: Later | None = None, **given: Any) -> dict[str, tuple[str, str]]:
    """Light and text by subject, with a search whose best set is better than its baseline in the first objective."""
    before = Baseline(objective=4.0, parameters={}, scores={})
    judged = trust(campaign("exact", baseline=before, cells={"reused": 0}, **given), chosen=chosen, later=later)
    return {reason.about: (reason.light, reason.text) for reason in judged.reasons}


@pytest.mark.parametrize(
    ("compared", "light"),
    [
        ([COMFORT, ENERGY], "amber"),
        ([COMFORT], "green"),
        ([ENERGY], "amber"),
        ([BesideBaseline("a", 1.0, 1.0, 1)], "amber"),
        ([COMFORT, replace(ENERGY, tolerance=1.0)], "green"),
        ([replace(ENERGY, tolerance=1.0)], "amber"),
        ([replace(COMFORT, tolerance=2.0)], "neutral"),
        ([replace(COMFORT, tolerance=2.0), replace(ENERGY, tolerance=1.0)], "neutral"),
    ],
)
def test_a_chosen_set_is_compared_with_the_baseline_in_each_objective(compared: list[BesideBaseline], light: str) -> None:
    about = about_the_set(Chosen({}, compared))
    assert about["baseline"][0] == light
    assert all(each.text in about["baseline"][1] for each in compared)
    assert not any("best set" in text for _, text in about.values())
    assert "baseline" not in about_the_set(Chosen({}))


def test_words_of_a_comparison_follow_the_direction() -> None:
    assert ENERGY.text == "energy 153.8, baseline 153.2: worse by 0.6"
    assert COMFORT.text.endswith("better by 2")
    assert replace(COMFORT, tolerance=2.0).text.endswith("better by 2, within the tolerance of 2")


def test_copied_scores_and_broken_constraints_of_a_chosen_set_are_named() -> None:
    about = about_the_set(Chosen({}, [COMFORT], copied=["S2"], violation=0.2), notes=[f"{CONFIRMED}: 1 set tried"])
    assert about["constraints"][0] == "red"
    assert about["confirmation"][0] == "amber"
    assert "S2" in about["confirmation"][1]


def test_the_verdict_on_the_best_set_is_that_of_a_chosen_set_if_it_is_the_same() -> None:
    notes = [f"{NOT_CONFIRMED}: the score in S4 is a reference's"]
    assert about_the_set(Chosen({}, is_best=True), notes=notes)["confirmation"][0] == "red"
    assert about_the_set(Chosen({}), notes=notes)["confirmation"][0] == "green"


def test_values_of_a_chosen_set_at_an_end_of_their_range_are_named() -> None:
    search = Search([], {"P1": (0.5, 2.0), "P2": (0.0, 1.0)})
    judged = trust(campaign(), search=search, chosen=Chosen({"P1": 0.7, "P2": 1.0}))
    (ends,) = (reason.text for reason in judged.reasons if reason.about == "search")
    assert "P2 (1)" in ends
    assert "P1" not in ends


@pytest.mark.parametrize(("dominating", "light"), [(3, "green"), (0, "amber"), (None, None)])
def test_several_objectives_count_the_sets_that_beat_the_baseline(dominating: int | None, light: str | None) -> None:
    before = Baseline(objective=4.0, parameters={}, scores={})
    search = Search([], {"P1": (0.5, 2.0)})
    judged = trust(campaign("exact", baseline=before), search=search, front=Compromises(7, dominating))
    about = {reason.about: reason for reason in judged.reasons}
    assert (about["baseline"].light if "baseline" in about else None) == light
    assert not any("best set" in reason.text for reason in judged.reasons)


@pytest.mark.parametrize(("copied", "light"), [(0, "green"), (2, "amber")])
def test_copied_scores_on_a_front_are_amber(copied: int, light: str) -> None:
    judged = trust(campaign("exact"), front=Compromises(7, None, copied))
    assert [reason.light for reason in judged.reasons if reason.about == "confirmation"] == [light]

"""The light of a campaign's result, and the verdicts behind it."""

from dataclasses import replace
from typing import Any

import pytest
from tests.support.values import COST

from drivecal.analysis.trust import BesideBaseline, Chosen, Compromises, Evidence, SearchCourse, trust
from drivecal.analysis.verdicts import SENTENCES, sentence
from drivecal.contracts.campaign import (
    Baseline,
    Best,
    Campaign,
    CellCounts,
    Confirmation,
    ErrorRate,
    FirstObjective,
    Released,
    Spent,
    Study,
)
from drivecal.contracts.results import ResultVerdict, StudyResult
from drivecal.contracts.tables import Generation, RobustnessRow, ValidationRow

BEST = Best(objective=6.0, parameters={"P1": 0.5}, scores={"S1": 6}, alternatives=1)
CONFIRMED = Confirmation(state="confirmed", tried=1, objective=6.0, believed=6.0)
LOTS = {"S1": ErrorRate(lots=3)}
NEAR = Released(limit=0.05, lots=4, rejected=1, inspected=400, predicted=300, sampled=40, different=3)
COMFORT = BesideBaseline("comfort", 6.0, 4.0, 1)
ENERGY = BesideBaseline("energy", 153.8, 153.2, -1)
EXACT: dict[str, Any] = {"cells": {"reused": 0}}


def campaign(mode: str = "both", *, cells: dict[str, int] | None = None, **given: Any) -> Campaign:
    known: dict[str, Any] = {"id": "c", "name": "a campaign", "state": "succeeded", "best": BEST}
    reduction = {"mode": mode, **given.pop("reduction", {})}
    spec = {"optimizer": {"kind": "genetic"}, "reduction": reduction}
    counts = CellCounts(**{"proposed": 100, "requested": 100, "reused": 20, "simulated": 80, **(cells or {})})
    return Campaign(**{**known, "spec": spec, "stages": {"calibration": counts}, **given})


def before(objective: float, **given: Any) -> Baseline:
    return Baseline(objective=objective, parameters={}, scores={}, **given)


def validation(error_rate: float, lower: float, scenario: str = "S1", **given: Any) -> ValidationRow:
    counts = dict.fromkeys(("reducible", "effects", "covered", "drawn", "references"), 1)
    known: dict[str, Any] = {"bases": 100, "compared": 100, "wrong": 0, "different": 0, "upper_95": 0.015, "histogram": {}}
    return ValidationRow(**{"scenario": scenario, "error_rate": error_rate, "lower_95": lower, **counts, **known, **given})


def studied(*rows: ValidationRow | RobustnessRow, by: str = "v") -> StudyResult:
    stage = "robustness" if isinstance(rows[0], RobustnessRow) else "validation"
    study = Study(campaign=by * 32, name="study", stage=stage, state="succeeded", settings={}, ended_at=None)
    return StudyResult.model_validate({"study": study, stage: list(rows)})


def robust(degree: int) -> RobustnessRow:
    return RobustnessRow(
        rank=1, objective=6.0, rating=6.0, degree=degree, at_least=False, radius=0.01 * degree, recommended=True, reason="the best",
        region=0, scores={}, parameters={}, trials=[],
    )  # fmt: skip


def verdicts(subject: Campaign, **known: Any) -> dict[str, ResultVerdict]:
    return {each.code: each for each in trust(subject, Evidence(**known)).verdicts}


def lights(subject: Campaign, **known: Any) -> dict[str, str]:
    return {code: each.light for code, each in verdicts(subject, **known).items()}


def point(best: float | None, rating: float | None, alternatives: int = 1) -> Generation:
    return Generation(iteration=0, best=best, rating=rating, alternatives=alternatives)


def stalled(*course: tuple[float | None, float | None]) -> list[Generation]:
    return [point(*each) for each in course]


@pytest.mark.parametrize(
    ("confirmation", "light", "words"),
    [
        (CONFIRMED, "green", "as the search believed; 1 set simulated again"),
        (
            CONFIRMED.model_copy(update={"believed": 7.0, "tried": 2}),
            "green",
            "the search believed 7.0000; 2 sets simulated again",
        ),
        (CONFIRMED.model_copy(update={"state": "untried", "reach": 6.5}), "amber", "others are believed to reach 6.5000"),
        (Confirmation(state="unconfirmed", tried=3, copied=["S4"]), "red", "the best set's score in S4 is still a copy"),
        (Confirmation(state="unconfirmed", tried=1, copied=["S4"], failed=True), "red", "its simulation failed; 1 set tried"),
        (Confirmation(state="unconfirmed", tried=2, front=7, front_copied=3), "red", "3 of the 7 sets of the front"),
        (Confirmation(state="untried", tried=2, front=7), "amber", "others are believed to be on the front"),
    ],
)
def test_the_outcome_of_a_confirmation_decides(confirmation: Confirmation, light: str, words: str) -> None:
    judged = trust(campaign("predicted", confirmation=confirmation))
    assert (judged.light("scores"), judged.verdicts[0].light, judged.verdicts[0].question) == (light, light, "scores")
    assert words in judged.verdicts[0].text


def test_without_a_confirmation_copies_are_amber() -> None:
    assert lights(campaign("predicted", reduction={"confirm": 0})) == {"never_confirmed": "amber"}
    assert lights(campaign(reduction={"confirm": 0}, **EXACT)) == {"scores_simulated": "green"}
    assert lights(campaign("predicted")) == {"scores_simulated": "green"}


@pytest.mark.parametrize(
    ("max_error", "rate", "lower", "light"),
    [(0.02, 0.211, 0.15, "amber"), (1.0, 0.211, 0.15, "red"), (1.0, 0.03, 0.01, "amber"), (0.02, 0.01, 0.0, "green")],
)
def test_a_wrong_map_is_amber_behind_lots_and_red_without_them(max_error: float, rate: float, lower: float, light: str) -> None:
    subject = campaign(reduction={"max_error": max_error}, confirmation=CONFIRMED)
    result = lights(subject, studies=[studied(validation(rate, lower))])
    assert result["map_validated" if light == "green" else "map_wrong"] == light


@pytest.mark.parametrize(("max_error", "light"), [(0.02, "neutral"), (1.0, "amber")])
@pytest.mark.parametrize("few", [{"upper_95": 0.975}, {"compared": 0, "error_rate": None, "upper_95": None}])
def test_a_map_is_validated_only_if_enough_sets_were_compared_in_every_scenario(
    max_error: float, light: str, few: dict[str, Any]
) -> None:
    subject = campaign(reduction={"max_error": max_error}, confirmation=CONFIRMED)
    result = lights(subject, studies=[studied(validation(0.0, 0.0, "S1"), validation(0.0, 0.0, "S2").model_copy(update=few))])
    assert result["map_validated"] == light


def test_the_newest_validation_of_a_scenario_counts() -> None:
    older = studied(validation(0.5, 0.4, "S1"), validation(0.3, 0.2, "S2"), by="o")
    wrong = verdicts(campaign(), studies=[studied(validation(0.0, 0.0, "S1")), older])["map_wrong"]
    assert (wrong.scenario, wrong.light, wrong.numbers["rates"]) == ("S2", "amber", {"S2": 0.3})


def test_scenarios_with_the_same_fault_share_a_verdict() -> None:
    rates = {**LOTS, "S5": ErrorRate(contradictions=3), "S6": ErrorRate(contradictions=12)}
    rows = [validation(0.3, 0.2, "S1"), validation(0.075, 0.0, "S2"), validation(0.0, 0.0, "S3")]
    result = verdicts(campaign(error_rate=rates), studies=[studied(*rows)])
    assert result["map_wrong"].numbers["rates"] == {"S1": 0.3, "S2": 0.075}
    assert "30.0 % in S1 and 7.5 % in S2" in result["map_wrong"].text
    assert result["contradictions"].numbers["groups"] == {"S5": 3, "S6": 12}


def test_a_wrong_map_does_not_matter_to_a_campaign_without_one_or_without_its_answers() -> None:
    assert "map_wrong" not in lights(campaign("exact"), studies=[studied(validation(0.5, 0.4))])
    unused = campaign(cells={"reused": 0}, error_rate={"S1": ErrorRate(contradictions=3)})
    assert {lights(unused, studies=[studied(validation(0.5, 0.4))])[code] for code in ("map_wrong", "contradictions")} == {
        "neutral"
    }


def test_reuse_without_lots_is_held_against_its_audits() -> None:
    rates = {"S2": ErrorRate(audited=100, wrong=1), "S3": ErrorRate(audited=100, wrong=10)}
    result = trust(campaign(reduction={"max_error": 1}, error_rate=rates)).verdicts
    assert {each.scenario: each.light for each in result if each.code == "audits_wrong"} == {"S2": "amber", "S3": "red"}
    assert "map_unchecked" in {each.code for each in result}
    rates = {"S2": ErrorRate(audited=9, wrong=4, lots=3, rejected=1), "S3": ErrorRate(audited=9, wrong=4, lots=3, rejected=2)}
    rates["S4"] = ErrorRate(audited=9, lots=3, rejected=3)  # samples without a result
    inspected = trust(campaign(error_rate=rates)).verdicts
    assert {each.scenario: each.light for each in inspected if each.code == "audits_wrong"} == {"S3": "amber"}, (
        "lots inspect these"
    )


@pytest.mark.parametrize(("beyond", "lower", "light"), [(2, 0.0, "green"), (12, 0.04, "amber"), (30, 0.2, "red")])
def test_validated_predictions_are_held_against_their_limit(beyond: int, lower: float, light: str) -> None:
    row = validation(0.0, 0.0, released=300, inspected=400, beyond=beyond, limit=0.05, beyond_lower_95=lower)
    assert lights(campaign("predicted"), studies=[studied(row)])["predictions_validated"] == light


def test_noise_failures_and_cut_scores_are_amber_if_they_matter() -> None:
    for failures, light in ((0, "neutral"), (1, "amber")):
        seeded = {"failures": failures, "failure_interval": (0.0, 0.07)}
        assert lights(campaign(best=BEST.model_copy(update=seeded)))["failing_runs"] == light
    assert lights(campaign(), chosen=Chosen({}, failures=2, failure_interval=(0.0, 0.1)))["failing_runs"] == "amber"
    for rate, least, light in ((0.1, 0.0, "neutral"), (0.03, 0.0, "amber"), (0.03, 0.031, "red"), (None, 0.0, "amber")):
        constraint = {"rate": rate} if rate else {"measure": "y", "at_most": 1.0}
        rated = {"optimizer": {"kind": "genetic"}, "constraints": [constraint]}
        seeded = {"failures": 1, "failure_interval": (least, 0.07)}
        assert lights(campaign(best=BEST.model_copy(update=seeded), spec=rated))["failing_runs"] == light
    counts = {"failed": 11, "unscored": 1, "unrepeatable": 2, "cut": 1}
    result = lights(campaign("predicted", cells=counts, released={"S1": NEAR}))
    assert result == {
        "noise": "amber",
        "without_result": "amber",
        "scores_simulated": "green",
        "lots": "green",
        "without_score": "neutral",
        "cut": "neutral",
    }
    assert lights(campaign(cells={"failed": 10}))["without_result"] == "neutral", "they are not of the best set"
    assert lights(campaign(cells={"cut": 11}))["cut"] == "amber"
    assert lights(campaign(), has_unknown_noise=True)["noise_unknown"] == "amber"
    for known, subject in (
        ({}, "the best set"),
        ({"front": Compromises(7, 3)}, "the front's sets"),
        ({"chosen": Chosen({})}, "the ch"),
    ):
        assert subject in verdicts(campaign(cells={"cut": 1}), at_worst=["time in S1"], **known)["at_worst"].text


@pytest.mark.parametrize(("most", "fails", "light"), [(0.3, True, "green"), (0.4, True, None), (0.4, False, "green")])
def test_a_gain_that_unseen_failures_may_cost_is_not_known(most: float, fails: bool, light: str | None) -> None:
    best = BEST.model_copy(update={"failure_interval": (0.0, most)})
    baseline = before(4.0).model_copy(update={"gain": 2.0})
    result = trust(campaign(best=best, baseline=baseline), Evidence(has_failures=fails))
    assert result.light("baseline") == light  # a failed run is worth 0, the best set 6


@pytest.mark.parametrize(
    ("objective", "given", "code"),
    [
        (4.0, {}, "better_than_baseline"),
        (6.0, {}, "not_better"),
        (6.0, {"baseline": before(6.0).model_copy(update={"objective": None})}, "baseline_without_result"),
        (8.0, {"baseline": before(8.0, close=True)}, "baseline_in_interval"),
        (4.0, {"baseline": before(4.0, close=True)}, "baseline_in_interval"),
        (8.0, {"baseline": before(8.0).model_copy(update={"gain": 3.0})}, "better_than_baseline"),
        (4.0, {"baseline": before(4.0).model_copy(update={"gain": -3.0})}, "worse_than_baseline"),
        (4.0, {"baseline": before(4.0).model_copy(update={"gain": 0.0})}, "not_better"),
        (5.5, {}, "alike_baseline"),
        (4.0, {"scale": COST}, "not_better"),
        (7.0, {"scale": COST}, "alike_baseline"),
        (7.0, {"objective": FirstObjective(name="jerk", unit="1", direction="minimise")}, "better_than_baseline"),
    ],
)
def test_the_best_set_is_held_against_the_baseline(objective: float, given: dict[str, Any], code: str) -> None:
    result = verdicts(campaign(**{"baseline": before(objective)} | given))
    assert {each for each, known in result.items() if known.question == "baseline"} == {code}
    assert result[code].question == "baseline", "a better set finishes no search"


@pytest.mark.parametrize(("gain", "words"), [(-3.0, "a loss of 3 under"), (3.0, "a gain of 3 under")])
def test_runs_that_tell_nothing_name_a_loss_a_loss(gain: float, words: str) -> None:
    beside = before(8.0, close=True).model_copy(update={"gain": gain})
    assert words in verdicts(campaign(baseline=beside))["baseline_in_interval"].text


def test_constraints_come_first() -> None:
    broken = BEST.model_copy(update={"violation": 0.1})
    judged = trust(campaign("exact", best=broken, **EXACT))
    assert (judged.light("scores"), judged.verdicts[0].code) == ("red", "no_set_keeps_constraints")
    assert "constraints_kept" not in lights(campaign(best=broken), bounded=["max of y <= 2: 1"])
    assert lights(campaign(), bounded=["max of y <= 2: 1"])["constraints_kept"] == "green"
    exact = ("rate", "green", "red"), ("changes", "green", "red")
    for kinds, kept, broke in (*exact, ("at_most", "neutral", "amber"), ("rate at_most", "neutral", "red")):
        spec, means = {"constraints": [{kind: 0.1} for kind in kinds.split()]}, {"replicates": 8}
        known = [campaign(spec=spec, best=best.model_copy(update=means)) for best in (BEST, broken)]
        assert lights(known[0], bounded=["max of y <= 2: 1"], is_random=True)["constraints_kept"] == kept
        assert lights(known[1], is_random=True)["constraints_broken"] == broke
        assert lights(known[0], chosen=Chosen({}, violation=0.2), is_random=True)["constraints_broken"] == broke
    breaking = before(7.0, violation=0.1)
    assert lights(campaign(baseline=breaking))["baseline_breaks_more"] == "green"
    assert (
        lights(campaign(best=BEST.model_copy(update={"violation": 0.05}), baseline=breaking))["baseline_breaks_more"] == "amber"
    )
    failing = before(4.0).model_copy(update={"scores": {"S1": 0.0, "S2": 4.0}})
    assert verdicts(campaign(baseline=failing))["baseline_fails"].numbers["scenarios"] == ["S1"]
    other = FirstObjective(name="jerk", unit="1", direction="minimise")
    assert "baseline_fails" not in lights(campaign(baseline=failing, objective=other))
    unsure = BEST.model_copy(update={"violation": 0.0001, "undecided": True})
    assert "baseline_breaks_more" not in lights(campaign(best=unsure, baseline=before(4.0, violation=0.1)))
    assert lights(campaign(best=unsure, baseline=before(4.0)))["better_than_baseline"] == "neutral"
    undecided = before(4.0, violation=0.0009, undecided=True)
    assert "better_than_baseline" in (result := lights(campaign(baseline=undecided)))
    assert "baseline_breaks_more" not in result
    assert "baseline_breaks_more" not in lights(campaign("exact", baseline=undecided), front=Compromises(7, 3))
    assert lights(campaign("exact"), front=Compromises(7, 3, is_close=True))["front_close_to_baseline"] == "neutral"


@pytest.mark.parametrize(
    ("constraint", "is_told"),
    [({"measure": "y"}, True), ({"measure": "y", "scenarios": ["S1"]}, False), ({"changes": "baseline"}, False)],
)
def test_a_scenario_of_weight_0_is_named_if_a_constraint_would_hold_there(constraint: dict[str, Any], is_told: bool) -> None:
    spec = {"optimizer": {}, "weights": {"S1": 2, "S2": 0}, "constraints": [constraint]}
    told = verdicts(campaign(spec=spec)).get("constraints_left_out")
    assert (told and (told.light, told.numbers)) == (("neutral", {"scenarios": ["S2"]}) if is_told else None)


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
    judged = trust(campaign("exact", state=state, best=best, error="out of memory", **EXACT))
    assert judged.light("search" if light == "amber" else "scores") == light


def test_a_campaign_without_a_search_has_no_answers() -> None:
    assert trust(campaign().model_copy(update={"spec": {"optimizer": None}})).answers == []


@pytest.mark.parametrize(
    ("course", "used", "gain", "light"),
    [
        ([4.0, 5.0, 5.5, 7.0], 200, 2.0, "amber"),
        ([4.0, 5.0, 5.5, 6.0], 200, 1.0, "amber"),
        ([4.0, 6.0, 6.0, 6.0, 6.0], 200, 2.0, "amber"),
        ([4.0, *[6.0] * 8], 200, 0.0, "green"),
        ([4.0, *[6.0] * 8], 98, None, "amber"),
        ([None, *[5.0] * 3, *[7.5] * 4, 8.0], 200, 2.5, "amber"),
        ([4.0, 4.0, 4.0], 200, None, "amber"),
        ([None, None, 5.5, 6.0], 200, None, None),
        ([6.0], 200, None, None),
    ],
)
def test_a_search_says_what_more_brings(course: list[float | None], used: int, gain: float | None, light: str | None) -> None:
    subject = campaign(budget={"simulations": 200}, ended_by="budget", spent=Spent(simulations=used))
    subject = subject.model_copy(update={"spec": subject.spec | {"optimizer": {"kind": "surrogate"}}})
    known = Evidence(search=SearchCourse(stalled(*((best, None) for best in course)), {}))
    by_code = {each.code: each for each in trust(subject, known).verdicts}
    assert by_code["budget"].numbers == {"used": f"{used} of 200 simulations"}
    shared = subject.model_copy(update={"spent": Spent(simulations=used, stored=7)})
    assert verdicts(shared)["budget"].numbers == {"used": f"{used} of 200 simulations, 7 of them from the table"}
    assert by_code["ended"].numbers["share"] <= 1
    assert (by_code["outlook"].numbers["gain"] if "outlook" in by_code else None) == gain
    assert ("no_outlook" in by_code) == (used < 150)
    begun = subject.model_copy(update={"stages": {"calibration": CellCounts(requested=200, repeated=30, simulated=170)}})
    told = verdicts(begun, search=known.search)
    assert ("outlook" in told, "30 stored answers" in told["budget"].text) == (False, True)
    assert (trust(subject, known).light("search"), by_code["ended"].light) == (light, "neutral")
    smooth = subject.model_copy(update={"scale": replace(subject.scale, step=None)})
    assert trust(smooth, known).light("search") == ("green" if gain == 1 else light)  # within the score's tolerance
    stalled_out = subject.model_copy(update={"ended_by": "stagnation"})
    assert verdicts(stalled_out, search=known.search)["ended"].light == "neutral", "it did not end as its user chose"
    chosen = stalled_out.model_copy(update={"budget": {"simulations": 200, "stagnation": 50}})
    assert trust(chosen, known).light("search") == "green"
    assert "outlook" not in verdicts(campaign(), search=SearchCourse(stalled((4.0, None), (6.0, None)), {}))


def test_a_first_set_that_failed_makes_no_later_gain_small() -> None:
    subject = campaign(budget={"simulations": 200}, ended_by="budget", spent=Spent(simulations=200))
    subject = subject.model_copy(update={"spec": subject.spec | {"optimizer": {"kind": "surrogate"}}})
    best, means = (-900.0, 4.0, 4.0, 4.0, 4.5, 5.0, 5.5, 6.0), (-900.0, -3.0, -2.0, 1.0, 2.0, 3.0, 3.0, 4.0)
    course = [point(each, None).model_copy(update={"mean": mean}) for each, mean in zip(best, means, strict=True)]
    assert trust(subject, Evidence(search=SearchCourse(course, {}))).light("search") == "amber"


@pytest.mark.parametrize(
    ("course", "given", "is_doubted"),
    [
        ([(6.0, 6.2)] * 3, {}, True),
        ([(6.0, None)] * 3, {}, True),
        ([(6.0, 6.2)] * 2, {}, False),
        ([(5.5, 6.2), (6.0, 6.2), (6.0, 6.2)], {}, False),
        ([(6.0, 6.2), (6.0, 6.2), (6.0, 6.3)], {}, True),
        ([(5.5, 6.2)] * 3, {}, False),
        ([(None, None)] * 3, {}, False),
        ([(6.0, 6.2)] * 3, {"state": "cancelled"}, False),
        ([(6.0, 6.2)] * 3, {"best": None}, False),
        ([], {}, False),
    ],
)
def test_a_search_that_its_first_iteration_decided_is_amber(course: Any, given: dict[str, Any], is_doubted: bool) -> None:
    assert ("stood_still" in lights(campaign(**given), search=SearchCourse(stalled(*course), {}))) is is_doubted


@pytest.mark.parametrize(("asked", "grid", "doubted"), [(54, 54, False), (48, 54, False), (30, 54, True), (9, 10**400, True)])
def test_a_search_that_saw_nearly_all_sets_missed_little(asked: int, grid: int, doubted: bool) -> None:
    result = verdicts(campaign(), search=SearchCourse(stalled(*[(6.0, 6.0)] * 5), {}, asked, grid))
    seen = result["seen"]
    assert ("stood_still" in result, seen.numbers["asked"], seen.light == "green") == (doubted, str(asked), not doubted)


def test_what_a_search_did_not_see_is_never_green() -> None:
    search = SearchCourse(stalled((4.0, None), (6.0, None)), {"P1": (0.5, 1.0)}, 1000, 10**27)
    result = trust(campaign(**EXACT), Evidence(search=search))
    assert [each.light for each in result.verdicts if each.code == "not_converged"] == ["amber", "neutral"]
    assert {each.code: each.light for each in result.verdicts if each.question == "search" and each.code != "not_converged"} == {
        "seen": "neutral", "still_rising": "amber", "at_ends": "amber",
    }  # fmt: skip
    assert (result.light("search"), result.light("scores")) == ("amber", "green")


def test_the_highest_score_in_steps_is_not_doubted() -> None:
    best, search = BEST.model_copy(update={"objective": 7.0}), SearchCourse(stalled(*[(7.0, None)] * 5), {})
    assert "stood_still" not in lights(campaign(best=best), search=search)
    assert "stood_still" in lights(campaign(best=best, scale=COST), search=search)


def test_convergence_is_told_by_both_criteria_of_the_paper() -> None:
    def told(course: Any, code: str) -> list[ResultVerdict]:
        return [row for row in trust(campaign(), Evidence(search=SearchCourse(course, {}))).verdicts if row.code == code]

    rising = [point(4.0, 4.0, 1), point(6.0, 6.0, 1), *[point(6.0, 6.0, 3)] * 8, point(6.0, 6.0, 4)]
    named = {row.numbers["of"]: row.numbers["iteration"] for row in told(rising, "not_converged")}
    assert named == {"best objective": 2, "number of alternative optima": 11}
    rested = told([*rising, *[point(6.0, 6.0, 4)] * 6], "converged")
    assert [(row.light, row.numbers["iteration"]) for row in rested] == [("neutral", 11), ("green", 2)]


def test_values_at_an_end_of_their_range_are_named() -> None:
    best = BEST.model_copy(update={"parameters": {"P1": 0.5, "P2": 3.0, "P3": 1.0, "mode": "eco"}})
    ranges = {"P1": (0.5, 2.0), "P2": (1.0, 3.0), "P3": (0.0, 2.0)}
    result = verdicts(campaign(best=best), search=SearchCourse([], ranges))["at_ends"]
    assert result.numbers["values"] == {"P1": 0.5, "P2": 3.0}
    assert "at_ends" not in lights(campaign(best=best), search=SearchCourse([], {"P3": (0.0, 2.0)}))
    failing = campaign(best=best.model_copy(update={"failures": 2}))
    assert lights(failing, search=SearchCourse([], ranges))["at_ends"] == "neutral"
    limits = {"P1": (None, ""), "P2": ("", "`upper: 3` of P2")}
    bound = verdicts(campaign(best=best), search=SearchCourse([], ranges, titles={"P2": "P at 5 m"}, limits=limits))["at_ends"]
    assert (bound.numbers["values"], bound.numbers["entries"]) == ({"P at 5 m": 3.0}, ["`upper: 3` of P2"])
    assert ("`upper: 3` of P2 in `problem.yaml`" in bound.text, "problem.yaml" in result.text) == (True, False)
    chosen = verdicts(campaign(), search=SearchCourse([], ranges), chosen=Chosen({"P1": 0.7, "P2": 3.0}))["at_ends"]
    assert chosen.numbers["values"] == {"P2": 3.0}
    assert "at_ends" in lights(campaign(best=best), search=SearchCourse([], ranges), front=Compromises(6, None))


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
        ([], None),
    ],
)
def test_a_chosen_set_is_compared_in_each_objective(compared: list[BesideBaseline], light: str | None) -> None:
    result = verdicts(campaign("exact", baseline=before(4.0), **EXACT), chosen=Chosen({}, compared))
    told = result.get("beside_baseline")
    assert (told and told.light, "better_than_baseline" in result) == (light, False)


def test_a_chosen_set_is_judged_by_its_own_scores() -> None:
    doubtful = Confirmation(state="unconfirmed", tried=1, copied=["S4"])
    assert lights(campaign(confirmation=doubtful), chosen=Chosen({}))["scores_simulated"] == "green"
    result = lights(campaign(), chosen=Chosen({}, copied=["S2"], violation=0.2))
    assert (result["scores_copied"], result["constraints_broken"]) == ("amber", "red")
    assert lights(campaign(), chosen=Chosen({}, is_judged=False))["not_judged"] == "red"
    assert lights(campaign(), chosen=Chosen({}, failed=["S2"], scenarios=2))["fails"] == "amber"
    assert "2 of 7 sets" in verdicts(campaign(), front=Compromises(7, 3, failing=2, failed=["S1"]))["fails"].text
    assert lights(campaign(best=BEST.model_copy(update={"failed": ["S1"]})))["fails"] == "red"
    assert lights(campaign(), chosen=Chosen({}, baseline_violation=0.1))["baseline_breaks_more"] == "green"


@pytest.mark.parametrize(("dominating", "code"), [(3, "front_beats_baseline"), (0, "front_not_better"), (None, None)])
def test_several_objectives_count_the_sets_that_beat_the_baseline(dominating: int | None, code: str | None) -> None:
    result = lights(campaign("exact", baseline=before(4.0)), front=Compromises(7, dominating))
    assert {"front_beats_baseline", "front_not_better", "better_than_baseline"} & set(result) == ({code} if code else set())
    assert lights(campaign("exact"), front=Compromises(7, None, copied=2))["front_copied"] == "amber"


@pytest.mark.parametrize(("late", "is_random", "light"), [(3, False, "amber"), (0, False, "green"), (3, True, "neutral")])
def test_a_front_that_still_grew_is_not_finished(late: int, is_random: bool, light: str) -> None:
    result = verdicts(campaign("exact", ended_by="budget"), front=Compromises(7, None, late=late), is_random=is_random)
    [found] = [each for code, each in result.items() if code in {"front_grew", "front_stood"}]
    assert (found.light, found.numbers["late"]) == (light, late)


def test_a_robustness_study_says_how_far_the_recommended_set_holds() -> None:
    assert lights(campaign(), studies=[studied(robust(0))])["not_robust"] == "amber"
    assert lights(campaign(), studies=[studied(robust(3))])["robust"] == "green"
    bounded = BEST.model_copy(update={"constraints": {"max of y": 1.0}})
    assert lights(campaign(best=bounded), studies=[studied(robust(3))])["robust"] == "neutral"
    two = campaign().spec | {"objectives": [{"score": "comfort"}, {"score": "energy"}]}
    assert lights(campaign(spec=two), studies=[studied(robust(3))])["robust"] == "neutral"


@pytest.mark.parametrize(
    ("code", "numbers", "text"),
    [
        (
            "at_ends",
            {"subject": "the best set", "values": {"P1": 0.5}, "entries": []},
            "In the best set P1 (0.5) lies at or near",
        ),
        (
            "at_ends",
            {"subject": "the best set", "values": {"P1": 1.0, "P2": 2.0}, "entries": []},
            "In the best set P1 (1), P2 (2) lie at or near",
        ),
        (
            "lots",
            {"kind": "reused", "lots": 1200, "inspected": 9000, "sampled": 1800, "rejected": 1},
            "Of 9,000 cells that could be reused, in 1,200 lots, 1,800 were",
        ),
        (
            "beside_baseline",
            {
                "objectives": [
                    {"name": "energy", "value": 153.8, "baseline": 153.2, "unit": "1", "gain": -0.6, "tolerance": 0.0},
                    {"name": "comfort", "value": 6.0, "baseline": 4.0, "unit": "1", "gain": 2.0, "tolerance": 2.0},
                    {"name": "gap", "value": 1.0, "baseline": 1.0, "unit": "m", "gain": 0.0, "tolerance": 0.0},
                ]
            },
            "The chosen set beside the baseline: energy 153.8, baseline 153.2: worse by 0.6; comfort 6, baseline 4: better by 2, within",
        ),
    ],
)
def test_a_verdict_becomes_a_sentence(code: str, numbers: dict[str, Any], text: str) -> None:
    assert sentence(code, numbers).startswith(text)
    assert code in SENTENCES

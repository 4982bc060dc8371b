"""Campaigns with a problem bundle: what they resolve to, and how the coordinator rates measures."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.support.values import faulty_fields, present

from drivecal.bundles.checks import checked
from drivecal.bundles.highway_catalogue import MEASURES as CATALOGUE
from drivecal.bundles.installed import Bundle
from drivecal.campaigns.resolve.bench import Bench
from drivecal.campaigns.resolve.maps import resolve_map
from drivecal.campaigns.resolve.problem import CalibrationProblem, resolve, resolve_evaluation
from drivecal.contracts.specification import CampaignSpecification, EvaluationSpecification, InfluenceMapSpecification
from drivecal.domain.errors import NotFoundError

EXAMPLE = Path(__file__).parents[3] / "deploy" / "examples" / "problems" / "python-function" / "problem.yaml"
TEMPLATES = Path(__file__).parents[3] / "services" / "drivecal" / "client" / "templates"
MEASURES = {"min_gap_m": 4.0, "peak_deceleration": 8.0, "rms_jerk": 2.0, "braking_s": 1.5}


def bundle(digest: str = "d1", files: str = "f1", **changes: Any) -> Bundle:
    return Bundle(digest, files, checked({**yaml.safe_load(EXAMPLE.read_text()), **changes}))


def resolved(stored: Bundle | None = None, **settings: Any) -> CalibrationProblem:
    known = stored or bundle()

    def find(name: str) -> Bundle:
        if name in {known.digest, known.manifest.problem}:
            return known
        raise NotFoundError("problem", name)

    document = {"problem": "python-function", "sensitivity": None, "optimizer": {"population": 10, "iterations": 2}, **settings}
    return resolve(CampaignSpecification.model_validate(document), find)


def bench_of(stored: Bundle, score: str) -> Bench:
    document = {"problem": stored.manifest.problem, "evaluator": score, "optimizer": {"population": 10, "iterations": 2}}
    return resolve(CampaignSpecification.model_validate(document), lambda _: stored).bench


def fields(**settings: Any) -> set[str]:
    return set(faulty_fields(resolved, **settings))


def rated(score: str, measures: dict[str, float | None], failure: str | None = None) -> float | None:
    rating = bench_of(bundle(), score).rate("wet", measures, failure)
    return None if rating is None else rating.rating


def test_the_built_in_traffic_stores_measures_that_only_a_later_push_declares() -> None:
    given = yaml.safe_load((EXAMPLE.parents[1] / "acc-highway" / "problem.yaml").read_text())
    stored = Bundle("d1", "f1", checked(given))
    request = bench_of(stored, next(iter(given["scores"]))).requests[next(iter(given["scenarios"]))]
    assert len(set(request.measures)) == len(request.measures)
    assert set(request.measures) == set(CATALOGUE) > given["measures"].keys()
    (new, unit) = next((name, unit) for name, unit in CATALOGUE.items() if name not in given["measures"])
    score = {"formula": new, "direction": "minimise", "range": [0, 100]}
    later = checked({**given, "measures": {**given["measures"], new: unit}, "scores": {"later": score}})
    rating = present(
        bench_of(Bundle("d2", "f1", later), "later").rate(request.scenario, dict.fromkeys(request.measures, 3.0), None)
    )
    assert rating.rating == 3.0
    problem = resolved(stored, problem=stored.manifest.problem)
    assert problem.bench.requests[request.scenario].run_fingerprint == request.run_fingerprint
    goal = {"measure": new, "direction": "minimise"}
    resolved(stored, problem=stored.manifest.problem, optimizer={"kind": "surrogate"}, objectives=[goal])
    assert bench_of(bundle(), "discomfort").requests["wet"].measures == tuple(bundle().manifest.measures)


@pytest.mark.parametrize(
    ("tolerance", "reduction", "noted"),
    [
        (0.0, {}, True),
        (0.0, {"tolerance": 0.5}, False),
        (0.0, {"mode": "exact"}, False),
        (0.0, {"mode": "both"}, True),
        (2.0, {}, False),
        (2.0, {"tolerance": 0.0}, True),
    ],
)
def test_a_predicted_score_without_tolerance_is_noted(tolerance: float, reduction: dict[str, Any], noted: bool) -> None:
    scores = yaml.safe_load(EXAMPLE.read_text())["scores"]
    changed = bundle(scores={name: {**score, "tolerance": tolerance} for name, score in scores.items()})
    notes = resolved(changed, reduction=reduction).notes
    assert any("tolerance" in note for note in notes) == noted
    alone = {"optimizer": None, "sensitivity": {"samples": 2, "intervals": 2}}
    assert not any("tolerance" in note for note in resolved(changed, reduction=reduction, **alone).notes)


@pytest.mark.parametrize(
    ("document", "fields"),
    [
        (
            {"scenarios": {"S1": {}, "wet": {"P1": {}, "jerk": {"lower": 11}}}},
            {"scenarios.S1", "scenarios.wet.P1", "scenarios.wet.jerk.lower"},
        ),
        ({"scenarios": {"wet": {"warning": {"lower": 1}}}}, {"scenarios.wet.warning"}),
        ({"driving_function": "mpc", "scenarios": {"wet": {}}}, {"driving_function"}),
        ({"problem": "unknown", "scenarios": {"wet": {}}}, {"problem"}),
    ],
)
def test_a_map_that_does_not_fit_its_problem_is_refused_by_field(document: dict[str, Any], fields: set[str]) -> None:
    def find(name: str) -> Bundle:
        if name == "unknown":
            raise NotFoundError("problem", name)
        return bundle()

    assert (
        set(
            faulty_fields(
                resolve_map, InfluenceMapSpecification.model_validate({"problem": "python-function", **document}), find
            )
        )
        == fields
    )


def test_a_name_becomes_the_digest_of_its_latest_push() -> None:
    problem = resolved()
    specification = problem.specification
    assert (specification.problem, specification.evaluator) == ("d1", "discomfort")
    assert specification.catalogue == ["standing", "slower", "wet", "crossing"]
    assert problem.scenarios == ("standing", "slower", "wet", "crossing")
    assert [parameter.kind for parameter in problem.space.searched] == ["continuous", "grid", "grid", "integer", "choice"]
    assert problem.bench.scale.name == "discomfort"


def test_scenarios_and_score_are_chosen_as_for_the_built_in_problem() -> None:
    problem = resolved(catalogue=["wet", "slower"], evaluator="safety", weights={"wet": 3})
    assert problem.weights == {"slower": 0.25, "wet": 0.75}
    assert problem.bench.scale.name == "safety"


def test_everything_that_does_not_exist_is_named_at_once() -> None:
    assert fields(problem="unknown") == {"problem"}
    assert fields(catalogue=["wet", "dry"], evaluator="reference", driving_function="frenet", robustness={}) == {
        "catalogue[1]",
        "evaluator",
        "driving_function",
        "robustness",
    }


def test_files_and_scenario_decide_a_setup_but_no_score() -> None:
    setups = resolved().bench.setups
    assert len({setup.fingerprint for setup in setups.values()}) == len(setups)
    other_score = {"speed": {"formula": "braking_s", "direction": "minimise", "range": [0, 5]}}
    assert resolved(bundle("d2", scores=other_score)).bench.setups == setups
    manifest = yaml.safe_load(EXAMPLE.read_text())
    wider = {**manifest["parameters"], "jerk": {"lower": 5, "upper": 90, "step": 1}, "warning": {"choices": ["belt", "none"]}}
    assert resolved(bundle("d2", parameters=wider, constraints=[], baseline=None)).bench.setups == setups
    changed = resolved(bundle("d2", "f2")).bench.setups
    assert all(changed[name].fingerprint != setup.fingerprint for name, setup in setups.items())


def test_what_a_simulator_is_told_is_part_of_a_setup() -> None:
    fractions = {**yaml.safe_load(EXAMPLE.read_text())["parameters"], "confirmations": {"lower": 1, "upper": 6, "step": 1}}
    assert resolved(bundle(parameters=fractions)).bench.setups != resolved().bench.setups
    process = {"kind": "process", "command": ["./braking"], "deterministic": True}
    one, other = (resolved(bundle(simulator=process, problem=name), problem="d1").bench.setups for name in ("one", "other"))
    assert one["wet"].fingerprint != other["wet"].fingerprint, "the greeting names the problem"
    renamed = resolved(bundle(problem="other"), problem="d1").bench.setups
    assert renamed == resolved().bench.setups


def test_the_score_is_part_of_the_evaluator() -> None:
    scores = {"discomfort": {"formula": "braking_s", "direction": "minimise", "range": [0, 100]}}
    assert resolved(bundle("d2", scores=scores)).bench.evaluator_id != resolved().bench.evaluator_id
    assert resolved(bundle("d2", "f2")).bench.evaluator_id == resolved().bench.evaluator_id


def test_a_score_is_computed_from_measures() -> None:
    assert rated("discomfort", dict(MEASURES)) == pytest.approx(2 * 8 + 0.5 * 2 + 8 * 1.5 + 15 / 5)


@pytest.mark.parametrize(
    ("measures", "failure"),
    [
        ({}, "collision"),
        ({**MEASURES, "min_gap_m": -1.0}, None),  # division by zero
        ({**MEASURES, "peak_deceleration": 1000.0}, None),
    ],
)
def test_nothing_is_worse_than_a_failed_run(measures: dict[str, float | None], failure: str | None) -> None:
    assert rated("discomfort", measures, failure) == 100


def test_simulators_that_claim_nothing_are_run_twice_now_and_then() -> None:
    simulator = {**yaml.safe_load(EXAMPLE.read_text())["simulator"], "deterministic": False}
    assert resolved().bench.repeated_share == 0
    assert resolved(bundle(simulator=simulator)).bench.repeated_share == pytest.approx(0.02)
    assert resolved(bundle(simulator=simulator), reduction={"repeat": 0}).bench.repeated_share == 0


def test_the_answer_of_the_probe_is_part_of_every_setup() -> None:
    simulator = {**yaml.safe_load(EXAMPLE.read_text())["simulator"], "probe": ["python3", "--version"]}
    unknown = resolved(bundle(simulator=simulator))
    old, new = (resolved(replace(bundle(simulator=simulator), tools=version)) for version in ("3.11", "3.12"))
    assert unknown.bench.to_probe is not None
    assert (old.bench.to_probe, resolved().bench.to_probe) == (None, None)
    assert len({problem.bench.setups["wet"].fingerprint for problem in (unknown, old, new, resolved())}) == 4
    requests = [problem.bench.requests["wet"] for problem in (old, new)]
    assert [request.tools for request in requests] == ["3.11", "3.12"]
    assert any("3.11" in note for note in old.notes)


@pytest.mark.parametrize(
    ("name", "value"), [("confirmations", 1.5), ("jerk", 81.0), ("warning", "horn"), ("warning", 1.0), ("trigger_ttc", 1e-12)]
)
def test_a_single_evaluation_stays_in_the_space(name: str, value: float | str) -> None:
    values = {"trigger_ttc": 1.61, "deceleration": 7.0, "jerk": 30.0, "confirmations": 2.0, "warning": "sound", name: value}
    specification = EvaluationSpecification.model_validate({"problem": "python-function", "parameters": values})
    assert set(faulty_fields(resolve_evaluation, specification, lambda _: bundle())) == {f"parameters.{name}"}


def test_a_deterministic_simulator_runs_under_seeds_that_are_named_and_not_under_a_number_of_them() -> None:
    """A campaign runs it under further seeds if its runs differ in spite of that, and such a set can be simulated again."""
    values = {"trigger_ttc": 1.6, "deceleration": 7.0, "jerk": 30.0, "confirmations": 2.0, "warning": "sound"}
    asked = EvaluationSpecification.model_validate({"problem": "python-function", "parameters": values, "seeds": [14, 13]})
    assert resolve_evaluation(asked, lambda _: bundle()).seeds == (13, 14)
    assert set(faulty_fields(resolve_evaluation, asked.model_copy(update={"seeds": 2}), lambda _: bundle())) == {"seeds"}


def test_the_problem_s_baseline_is_the_default() -> None:
    baseline = present(resolved().baseline)
    assert baseline.floats["warning"] == "sound"
    narrow = [{"name": "jerk", "lower": 40, "upper": 80, "step": 2}]
    held = {"trigger_ttc": 2, "deceleration": 7, "confirmations": 2, "warning": "sound"}
    problem = resolved(bundle(constraints=["jerk <= 70", "deceleration <= 8"]), parameters=narrow, fixed=held)
    assert [note for note in problem.notes if "<=" in note] == [
        "sets that break jerk <= 70 are replaced by feasible ones near them"
    ]
    assert problem.baseline is None
    assert any("baseline" in note for note in problem.notes)
    assert problem.space.searched[0].unit == "m/s³"


def test_the_first_score_of_the_objectives_is_the_campaigns_and_others_are_computed() -> None:
    problem = resolved(
        objectives=[{"score": "safety"}, {"score": "discomfort", "aggregate": "max"}], optimizer={"kind": "surrogate"}
    )
    assert problem.bench.scale.name == problem.specification.evaluator == "safety"
    assert problem.specification.reduction.mode == "exact"
    safety, discomfort = problem.goals.objectives
    assert (safety.sign, discomfort.sign) == (1, -1)
    computed = problem.goals.values(dict(MEASURES), None)
    assert computed == {discomfort.value.key: rated("discomfort", dict(MEASURES))}
    assert problem.goals.values(dict(MEASURES), "collision") == {discomfort.value.key: 100.0}
    again = resolved(**problem.specification.model_dump(mode="json") | {"problem": "python-function"})
    assert again.goals == problem.goals


def test_constraints_on_results_name_scores_and_measures_of_the_bundle() -> None:
    limits = [{"measure": "min_gap_m", "at_least": 2.0}, {"score": "discomfort", "at_most": 50.0}]
    problem = resolved(constraints=limits, optimizer={"kind": "surrogate"})
    assert [objective.name for objective in problem.goals.objectives] == ["discomfort"]
    assert [(bound.aggregate.kind, bound.span) for bound in problem.goals.bounds] == [("min", 2.0), ("max", 100.0)]
    random = bundle(simulator={"kind": "process", "command": ["mysim"], "random": True})
    for worth, noted in ({}, 1), ({"failed": 0}, 0):
        notes = resolved(random, constraints=[limits[0] | worth], optimizer={"kind": "surrogate"}).notes
        assert sum("min_gap_m" in note for note in notes) == noted
    unsaid = {"kind": "command", "command": ["mysim", "{parameters}", "{results}", "{seed}"]}
    for said, noted in ({}, 1), ({"random": True}, 0):
        assert sum("{seed}" in note for note in resolved(bundle(simulator=unsaid | said)).notes) == noted
    assert fields(constraints=[{"measure": "no", "at_least": 2}], optimizer={"kind": "surrogate"}) == {"constraints[0].measure"}


def test_expected_runs_hold_the_further_seeds_of_random_runs_and_the_budget() -> None:
    random = bundle(simulator={"kind": "process", "command": ["mysim"], "random": True})

    def at_most(**settings: Any) -> int:
        return resolved(random, **settings).expected_runs().calibration_at_most

    one, five = ({"replicates": {"least": number, "most": number}} for number in (1, 5))
    assert at_most(**five) > 5 * at_most(**one)
    assert at_most(**five, budget={"simulations": 200}) == 200


def test_robustness_studies_vary_what_a_problem_declares() -> None:
    robust = {"samples": 2, "steps": 2}
    assert fields(robustness=robust) == {"robustness"}
    varied = {"slope": {"nominal": 0.01, "lower": -0.1, "upper": 0.1}}
    problem = resolved(bundle(varied=varied), robustness=robust)
    assert [each.name for each in problem.bench.varied] == ["slope"]
    assert faulty_fields(resolved, bundle(varied=varied), robustness=robust | {"eta": 1e4}) == ["robustness.eta"]
    resolved(bundle(varied=varied), robustness=robust | {"eta": 1e4, "condition": "mean"})  # a share of the score
    for condition, eta in ("max", problem.bench.scale.tolerance or 0.01 * problem.bench.scale.span), ("mean", 1.0):
        settled = resolved(bundle(varied=varied), robustness=robust | {"condition": condition}).specification
        assert present(settled.robustness).eta == eta
    steep = replace(problem.bench, values={"slope": 0.1})
    assert steep.requests["wet"].varied == {"slope": 0.1}
    assert len({bench.requests["wet"].session_key for bench in (problem.bench, steep, replace(steep, seed=2))}) == 1
    assert steep.requests["wet"].run_fingerprint != problem.bench.requests["wet"].run_fingerprint
    assert steep.requests["wet"].kind == problem.bench.requests["wet"].kind


def test_an_installed_evaluator_may_give_a_score_of_any_problem() -> None:
    scores = {"comfort": {"evaluator": "reference", "direction": "maximise", "range": [0, 7], "step": 1, "failed": 0}}
    metrics = dict.fromkeys(("peak_lateral_acceleration_mps2", "peak_lateral_jerk_mps3"), 0.0)
    metrics |= dict.fromkeys(("peak_longitudinal_acceleration_mps2", "peak_longitudinal_jerk_mps3"), 0.0)
    scenarios = {"wet": {"rated_as": "lane_change"}}
    rating = present(bench_of(bundle(scores=scores, scenarios=scenarios), "comfort").rate("wet", dict(metrics), None))
    assert (rating.score, rating.rating) == (7, 7.0)

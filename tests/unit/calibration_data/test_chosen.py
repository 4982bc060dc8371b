"""Calibration files of a campaign's sets: their quality data belong to the ranking that was asked for."""

from collections.abc import Mapping
from typing import Any

import pytest

from drivecal.calibration_data import cdfx, dcm
from drivecal.calibration_data.chosen import RankedBy, characteristics_of, front_figures, quality_of, solution_figures
from drivecal.calibration_data.files import CalibrationFormat, write
from drivecal.contracts.campaign import Baseline, Campaign, ErrorRate, FirstObjective, Study
from drivecal.contracts.results import (
    CampaignResults,
    FrontBaseline,
    FrontObjective,
    FrontSummary,
    Light,
    ResultTrust,
    ResultVerdict,
    StudyResult,
)
from drivecal.contracts.setup import CampaignSetup, ScenarioSetup, SearchedParameter
from drivecal.contracts.tables import FrontRow, RobustnessRow, Solution
from drivecal.domain.scales import Direction, Scale

Weights = Mapping[str, float] | None
FORMS: tuple[CalibrationFormat, ...] = ("dcm", "cdfx")
DISCOMFORT = Scale("discomfort", Direction.MINIMISE, lower=0.0, upper=20.0, tolerance=0.5, failed=20.0)
BASELINE = {"P1": 1.0, "mode": "eco"}
BEST = {"P1": 2.0, "mode": "sport"}
SCORES = {  # of the best set and the baseline, under each score
    None: ({"follow": 2.0, "brake": 4.0}, {"follow": 6.0, "brake": 11.0}),
    "following": ({"follow": 0.25, "brake": 0.75}, {"follow": 0.5, "brake": 1.5}),
}


class Data:
    """What is known of a campaign; `baseline_ranked`: whether its baseline has a value of every score."""

    def __init__(
        self, objective: FirstObjective | None = None, *, baseline_ranked: bool = True, light: Light | None = None
    ) -> None:
        self.objective, self.baseline_ranked, self.light = objective, baseline_ranked, light

    def campaign(self) -> Campaign:
        return Campaign(
            id="0" * 32, name="acc", state="succeeded", scale=DISCOMFORT, objective=self.objective,
            baseline=Baseline(objective=8.5, parameters=BASELINE, scores=SCORES[None][1]),
            error_rate={"brake": ErrorRate(upper_95=0.01)}, spec={"problem": "acc"},
        )  # fmt: skip

    def results(self) -> CampaignResults:
        worst = ResultVerdict(code="failed", question="scores", light=self.light or "green", text="Worst.")
        better = ResultVerdict(code="better_than_baseline", question="search", light="green", text="Better.")
        study = Study(campaign="s" * 32, name="study", stage="robustness", state="succeeded", settings={}, ended_at=None)
        return CampaignResults(
            campaign=self.campaign(),
            setup=self.setup(),
            trust=ResultTrust(light=self.light, verdicts=[worst, better]),
            studies=[StudyResult(study=study, robustness=self.robustness())],
        )

    def setup(self) -> CampaignSetup:
        mode = {"kind": "choice", "choices": ["eco", "sport"]}
        return CampaignSetup(
            evaluator="acc 1",
            server="1",
            parameters=[
                SearchedParameter(name="P1", unit="s", lower=0.0, upper=3.0, n_values=4, fixed=None),
                SearchedParameter(name="mode", unit="1", lower=0.0, upper=1.0, n_values=2, fixed=None, **mode),
            ],
            scenarios=[ScenarioSetup(scenario=name, weight=0.5, fingerprint="f") for name in ("follow", "brake")],
        )

    def robustness(self) -> list[RobustnessRow]:
        best = SCORES[None][0]
        row: dict[str, Any] = {
            "objective": 3.0,
            "rating": 3.0,
            "region": 1,
            "to_worse": None,
            "radius": 0.1,
            "at_least": False,
            "trials": [],
        }
        return [RobustnessRow(rank=1, degree=7, recommended=True, reason="", scores=best, parameters=BEST, **row)]

    def ranked(self, weights: Weights, score: str | None) -> list[Solution]:
        shares = {"follow": 0.5, "brake": 0.5} if weights is None else {"follow": 0.2, "brake": 0.8}
        return [
            Solution(
                rank=rank,
                objective=sum(share * scores[name] for name, share in shares.items()),
                rating=1.0,
                scores=scores,
                parameters=parameters,
                iteration=0,
                individual=rank,
            )
            for rank, (scores, parameters) in enumerate(
                zip(SCORES[None if score == "discomfort" else score], (BEST, BASELINE), strict=True), 1
            )
        ]

    def front(self, weights: Weights) -> FrontRow:
        return FrontRow(
            rank=1, objectives={"discomfort": 3.0, "jerk": 0.5}, weighted=None if weights is None else 0.75, violation=0.0,
            knee=True, best_in=["discomfort"], wins=0.6, weights=None, alternatives=1, degree=7, scores=SCORES[None][0],
            reused=[], parameters=BEST, iteration=0, individual=0,
        )  # fmt: skip

    def front_summary(self) -> FrontSummary:
        common = {"scenarios": {"follow": 0.5, "brake": 0.5}, "tolerance": 0.0, "reference": 20.0, "best": 1.0, "worst": 2.0}
        return FrontSummary(
            objectives=[
                FrontObjective(name="discomfort", unit="1", direction="minimise", aggregate="mean", **common),
                FrontObjective(name="jerk", unit="m/s3", direction="minimise", aggregate="max", **common),
            ],
            constraints=[],
            evaluated=2,
            feasible=2,
            size=1,
            copied=0,
            baseline=FrontBaseline(objectives={"discomfort": 8.5, "jerk": 0.75}, violation=0.0, rank=None),
            knee=1,
            hypervolume=None,
            growth=[],
        )


def written(
    data: Data, form: CalibrationFormat, *, weights: Weights = None, score: str | None = None, table: str = "solutions"
) -> bytes:
    chosen: Solution | FrontRow
    if table == "front":
        chosen = data.front(weights)
        figures = front_figures(data.results(), chosen, data.front_summary(), weights)
    else:
        chosen, before = data.ranked(weights, score)
        baseline = before.objective if data.baseline_ranked else None
        by = None if weights is None and score is None else RankedBy(score, weights, baseline)
        figures = solution_figures(data.results(), chosen, by)
    quality = quality_of(data.results(), chosen, figures, judged=data.light is not None)
    return write(form, characteristics_of(chosen.parameters, data.setup().parameters, {}), quality)


def exported(data: Data, *, weights: Weights = None, score: str | None = None, table: str = "solutions") -> dict[str, str]:
    """Returns the quality data of a DCM file, after a look at the CDFX."""
    content = [written(data, form, weights=weights, score=score, table=table) for form in FORMS]
    values = [{value.name: value.value for value in read.characteristics} for read in map(_read, content, FORMS)]
    assert values == [BEST, BEST]
    lines = (line[2:].partition(": ") for line in content[0].decode().splitlines() if line.startswith("* "))
    facts = {name: text for name, _, text in lines}
    known = {"encoding", "state", "date", "problem", "campaign", "test object"}
    figures = {name: text for name, text in facts.items() if name not in known and not name.startswith("encoding")}
    assert all(f'<SD GID="{name}">{text}</SD>' in content[1].decode() for name, text in figures.items())
    return figures


def _read(content: bytes, form: str) -> Any:
    return (dcm if form == "dcm" else cdfx).read(content, f"set.{form}")


@pytest.mark.parametrize(("light", "state"), [("red", "prelimCalibrated"), ("amber", "calibrated"), ("green", "calibrated")])
def test_a_set_of_a_campaign_with_a_red_light_is_preliminary(light: Light, state: str) -> None:
    lines = written(Data(light=light), "dcm").decode().splitlines()
    assert f"* state: {state}" in lines
    assert f"* light of the set: {light}" in lines
    assert ("* reason 1: Worst." in lines) is (light != "green")
    assert "* reason 2: Better." not in lines


def test_the_campaigns_own_ranking_is_named() -> None:
    assert exported(Data()) == {
        "objective": "3",
        "objective of the baseline": "8.5",
        "score": "discomfort, minimise, 0 to 20",
        "weights": "follow=0.5,brake=0.5",
        "rank": "1",
        "score follow": "2",
        "score brake": "4",
        "degree of robustness": "7",
        "share of wrong reused scores brake": "at most 1 % (95 %)",
    }


def test_another_score_is_named_and_the_baseline_has_it() -> None:
    expected = {
        "objective": "0.5",
        "objective of the baseline": "1",
        "score": "following",
        "weights": "follow=0.5,brake=0.5",
        "rank": "1",
        "score follow": "0.25",
        "score brake": "0.75",
    }
    assert exported(Data(), score="following") == expected
    without = exported(Data(baseline_ranked=False), score="following")
    assert without == {name: text for name, text in expected.items() if name != "objective of the baseline"}


def test_other_weights_are_named_and_hold_for_the_baseline() -> None:
    figures = exported(Data(), weights={"brake": 4.0})
    assert (figures["objective"], figures["objective of the baseline"]) == ("3.6", "10")
    assert figures["weights"] == "follow=1,brake=4"
    assert figures["score"].startswith("discomfort, minimise")


def test_the_first_objective_is_named_if_it_ranks() -> None:
    figures = exported(Data(FirstObjective(name="collisions", unit="1", direction="minimise")))
    assert figures["ranked by"] == "collisions, minimise"
    client = Data(FirstObjective(name="jerk", unit="m/s3", direction="minimise"))
    figures = exported(client)
    assert figures["ranked by"] == "jerk, minimise, m/s3"
    assert "weights" not in figures
    figures = exported(client, score="discomfort")
    assert "ranked by" not in figures
    assert (figures["weights"], figures["objective of the baseline"]) == ("follow=0.5,brake=0.5", "8.5")


def test_a_set_of_the_front_has_all_its_objectives() -> None:
    client = Data(FirstObjective(name="discomfort", unit="1", direction="minimise"))
    figures = exported(client, table="front")
    assert (figures["objective discomfort"], figures["objective jerk"]) == ("3", "0.5")
    assert figures["scale of objective jerk"] == "minimise, max, m/s3"
    assert figures["scale of objective discomfort"] == "minimise, mean"
    assert (figures["objective discomfort of the baseline"], figures["rank on the front"]) == ("8.5", "1")
    assert figures["objective jerk of the baseline"] == "0.75"
    assert (figures["score follow"], figures["degree of robustness"]) == ("2", "7")
    assert "weights of the objectives" not in figures
    weighted = exported(client, weights={"jerk": 2.0}, table="front")
    assert (weighted["weights of the objectives"], weighted["weighted objectives"]) == ("discomfort=1,jerk=2", "0.75")

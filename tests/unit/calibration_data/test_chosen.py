"""Calibration files of a campaign's sets: their quality data belong to the ranking that was asked for."""

from collections.abc import Mapping
from typing import Any

import pytest
from tests.support.problems import MANIFEST

from drivecal.analysis.verdicts import answers
from drivecal.api.results.curves import shapes_of
from drivecal.bundles.installed import Bundle
from drivecal.bundles.manifest import Manifest
from drivecal.calibration_data import cdfx, dcm
from drivecal.calibration_data.chosen import characteristics_of, curves_of, figures_of, quality_of
from drivecal.calibration_data.files import CalibrationFormat, write
from drivecal.campaigns.resolve.problem import resolve_evaluation
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.results import CampaignResults, Light, ResultTrust, ResultVerdict
from drivecal.contracts.setup import CampaignSetup, ScenarioSetup, SearchedParameter
from drivecal.contracts.specification import EvaluationSpecification, Given
from drivecal.contracts.tables import FrontRow, Solution
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
    """Answers of a server about a campaign."""

    def __init__(self, light: Light | None = None) -> None:
        self.light = light

    def campaign(self) -> Campaign:
        return Campaign(
            id="0" * 32, name="acc", state="succeeded", scale=DISCOMFORT, spec={"problem": "acc"},
        )  # fmt: skip

    def results(self) -> CampaignResults:
        worst = ResultVerdict(code="failed", question="scores", light=self.light or "green", text="Worst.")
        better = ResultVerdict(code="better_than_baseline", question="baseline", light="green", text="Better.")
        verdicts = [worst, better] if self.light else []
        return CampaignResults(
            campaign=self.campaign(),
            setup=self.setup(),
            trust=ResultTrust(answers=answers(verdicts, ended=True), verdicts=verdicts),
            studies=[],
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


def written(
    data: Data, form: CalibrationFormat, *, weights: Weights = None, score: str | None = None, table: str = "solutions"
) -> bytes:
    chosen = data.front(weights) if table == "front" else data.ranked(weights, score)[0]
    figures = figures_of(data.results(), chosen, weights, score)
    quality = quality_of(data.results(), chosen, figures)
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


def test_a_set_has_its_curves_and_the_points_of_their_axes() -> None:
    over = {"lower": 0.0, "upper": 90.0}
    entries = {
        "gain": {"curve": {"axis": [0, 10, 20], "axis_unit": "m/s"}, "coefficients": 2, "unit": "1/s", **over},
        "gain.x": {"curve": {"axis": [0, 1, 2]}, "monotone": "increasing", **over},
        "torque": {"map": {"x": [0, 1], "y": [5, 6, 7]}, **over},
        "block": {"map": {"x": [0, 1, 2], "y": [0, 1]}, **over},
        "gap": over,
    }
    manifest = Manifest.model_validate(MANIFEST | {"parameters": entries, "constraints": [], "baseline": None})
    table = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    given: dict[str, Given] = {
        "gain": [3.0, 2.0, 1.0],
        "gain.x": [0.0, 15.0, 20.0],
        "torque": table,
        "block": [[1.0, 2.0]] * 3,
        "gap": 1.0,
    }
    specification = EvaluationSpecification(problem="p", parameters=given)
    resolved = resolve_evaluation(specification, lambda _: Bundle("0" * 64, "1" * 64, manifest))
    values = {name: value for name, value in resolved.specification.parameters.items() if not isinstance(value, list)}
    assert (values["gain_1"], values["gain_2"], values["gap"], len(values)) == (3.0, 1.0, 1.0, 18)
    curves = curves_of(values, shapes_of(manifest), {"gain": "ACC_gain", "gain.x": "ACC_gain.x"})
    kinds = [("ACC_gain", "CURVE", [3.0, 2.0, 1.0]), ("torque", "MAP", table), ("block", "VAL_BLK", [[1.0, 2.0]] * 3)]
    for form in FORMS:
        read = _read(write(form, curves, None), form).characteristics
        assert [(each.name, each.kind, each.given) for each in read] == kinds
        assert (read[0].axes[0].points, read[0].axes[0].unit, read[1].axes[1].points) == (
            (0.0, 15.0, 20.0),
            "m/s",
            (5.0, 6.0, 7.0),
        )


@pytest.mark.parametrize(("light", "state"), [("red", "prelimCalibrated"), ("amber", "calibrated"), ("green", "calibrated")])
def test_a_set_whose_scores_have_a_red_light_is_preliminary(light: Light, state: str) -> None:
    lines = written(Data(light=light), "dcm").decode().splitlines()
    assert f"* state: {state}" in lines
    assert f"* light of the scores: {light}" in lines
    assert ("* reason 1: Worst." in lines) is (light != "green")
    assert "* reason 2: Better." not in lines


def test_an_undecided_set_breaks_no_constraint_by_a_figure() -> None:
    undecided = {"violation": 0.0009, "undecided": True, "constraints": {"gap": 2.5}}
    chosen = Data().ranked(None, None)[0].model_copy(update=undecided)
    known = Data().results()
    setup = known.setup.model_copy(update={"constraints": ["min of gap >= 2 m (S1)"]})
    names = dict(figures_of(known.model_copy(update={"setup": setup}), chosen, None, None))
    assert (names["constrained gap"], names["constraint 1"]) == ("2.5", "min of gap >= 2 m (S1)")
    assert ("violation of constraints" in names, "limits on rates" in names) == (False, True)


def test_a_set_of_a_random_simulator_has_the_interval_of_its_objective() -> None:
    chosen = Data().ranked(None, None)[0].model_copy(update={"standard_error": 0.25, "lower": 2.5})
    member = Data().front(None).model_copy(update={"uncertainty": {"jerk_lower": 0.4}})
    figures = [dict(figures_of(Data().results(), each, None, None)) for each in (chosen, member)]
    assert (figures[0]["standard error of the objective"], figures[1]["objective jerk_lower"]) == ("0.25", "0.4")
    assert "upper end of the objective" not in figures[0]


def test_a_set_has_its_rank_objective_and_scores() -> None:
    weights = {"weights": "follow=0.5,brake=0.5"}
    own = weights | {"rank": "1", "objective": "3", "score": "discomfort", "score follow": "2", "score brake": "4"}
    assert exported(Data()) == own
    assert exported(Data(), weights={"follow": 0.2, "brake": 0.8}) == own | {
        "objective": "3.6",
        "weights": "follow=0.2,brake=0.8",
    }
    other = weights | {"rank": "1", "objective": "0.5", "score": "following", "score follow": "0.25", "score brake": "0.75"}
    assert exported(Data(), score="following") == other


def test_a_set_of_the_front_has_all_its_objectives() -> None:
    figures = exported(Data(), table="front")
    assert (figures["objective discomfort"], figures["objective jerk"], figures["rank on the front"]) == ("3", "0.5", "1")
    assert figures["score follow"] == "2"
    assert exported(Data(), weights={"jerk": 2.0}, table="front")["weights"] == "jerk=2"


def test_an_integer_is_written_as_one() -> None:
    parameter = SearchedParameter(name="n", unit="1", lower=1.0, upper=8.0, n_values=8, fixed=None, kind="integer")
    [number] = characteristics_of({"n": 3.0}, [parameter], {})
    assert repr(number.value) == "3"

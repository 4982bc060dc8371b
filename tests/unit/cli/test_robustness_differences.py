from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from drivecal.analysis.robustness import difference
from drivecal.cli.views.robustness_differences import MadeStudy, document, print_difference
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.setup import CampaignSetup, ScenarioSetup
from drivecal.contracts.tables import RobustnessRow


def row(
    rank: int, name: float, degree: int, scores: Mapping[str, int | None], *, recommended: bool = False, at_least: bool = False
) -> RobustnessRow:
    return RobustnessRow(
        rank=rank,
        objective=float(sum(score or 0 for score in scores.values())),
        rating=5.0,
        parameters={"P1": name, "P2": 1.0},
        scores=dict(scores),
        region=1,
        to_worse=None,
        degree=degree,
        at_least=at_least,
        radius=0.01 * degree,
        recommended=recommended,
        reason="the widest box" if recommended else None,
        trials=[],
    )


def made(rows: Sequence[RobustnessRow], vehicle: str = "single_track", **settings: Any) -> MadeStudy:
    """A study of the sets of campaign `best`."""
    known = {"delta": 0.01, "steps": 10, "samples": 30, "eta": 1.0, "condition": "max", "of": "best", "sets": [], "seed": 1}
    spec = {"driving_function": "frenet", "vehicle": {"model": vehicle}, "robustness": known | settings}
    scenarios = [
        ScenarioSetup(scenario="S1", weight=0.5, fingerprint="f", vehicle=f"{vehicle} 1"),
        ScenarioSetup(scenario="S2", weight=0.5, fingerprint="f"),
    ]
    setup = CampaignSetup(evaluator="reference 1", parameters=[], scenarios=scenarios, server="1")
    return MadeStudy(Campaign(id="study", name="study", state="succeeded", spec=spec), setup, rows)


PLAIN = [
    row(1, 0.1, 10, {"S1": 6, "S2": 7}, recommended=True, at_least=True),
    row(2, 0.2, 7, {"S1": 6, "S2": None}),
    row(3, 0.3, 2, {"S1": 5, "S2": 5}),
]
HYBRID = [
    row(1, 0.2, 8, {"S1": 6, "S2": 5}, recommended=True),
    row(2, 0.1, 6, {"S1": 5, "S2": 7}),
    row(3, 0.3, 2, {"S1": 5, "S2": 6}),
    row(4, 0.4, 1, {"S1": 1, "S2": 1}),
]


def test_sets_are_compared_with_themselves() -> None:
    found = difference(PLAIN, HYBRID)
    assert (found.sets, found.only_one) == (3, 1)
    assert found.degrees == (1, 1, 1)
    assert list(found.mean_degree) == pytest.approx([19 / 3, 16 / 3])
    assert found.scores == (3, 1, 1), "five that both know"
    assert found.tau == pytest.approx(1 / 3), "one of three pairs is the other way round"
    assert not found.same_recommended


def test_nothing_changes_between_a_study_and_itself() -> None:
    found = difference(PLAIN, PLAIN)
    assert (found.degrees, found.scores, found.tau, found.same_recommended) == ((3, 0, 0), (5, 0, 0), 1.0, True)


def test_studies_without_a_common_set_have_nothing_to_compare(capsys: pytest.CaptureFixture[str]) -> None:
    assert difference(PLAIN[:1], HYBRID[3:]).tau is None
    print_difference(made(PLAIN[:1]), made(HYBRID[3:]))
    assert "0 sets" in capsys.readouterr().out


def test_what_changes_is_printed_and_given_to_programs(capsys: pytest.CaptureFixture[str]) -> None:
    print_difference(made(PLAIN), made(HYBRID, "hybrid"))
    printed = capsys.readouterr().out
    assert "1 -> 2" in printed
    assert ">= 10 -> 6" in printed
    assert "S1 6 -> 5" in printed
    assert "S2 - -> 5" in printed
    assert "mean 6.33 to 5.33" in printed
    assert "0.33" in printed
    assert "recommended: " in printed
    assert ": vehicle single_track 1 -> hybrid 1\n" in printed
    found: dict[str, Any] = document(made(PLAIN), made(HYBRID, "hybrid"))
    assert len(found["here"]) == 3
    assert found["settings"] == {"vehicle": ["single_track 1", "hybrid 1"]}


def test_studies_with_other_boxes_are_said_to_mean_other_degrees(capsys: pytest.CaptureFixture[str]) -> None:
    print_difference(made(PLAIN), made(PLAIN, delta=0.04, samples=15, eta=[1.0, 2.0], of="another", sets=[{"P1": 1}]))
    differs, meaning, *_ = capsys.readouterr().out.splitlines()
    assert differs == (
        "settings that differ: delta 0.01 -> 0.04, samples 30 -> 15, eta 1 -> 1.0, 2.0, "
        "of best -> another, sets none -> 1 given"
    )
    assert "condition" in meaning
    print_difference(made(PLAIN), made(PLAIN))
    assert capsys.readouterr().out.startswith("both studies have the same settings\n")

"""The account of a campaign, held against numbers worked out by hand."""

import re

import pytest
from tests.support.values import present

from drivecal.analysis.savings import MapOrigin, account
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Outcome, OutcomeCosts


def _costs(
    scenario: str,
    outcome: Outcome,
    cells: int,
    seconds: float,
    *,
    audited: bool = False,
    stage: StageName = StageName.CALIBRATION,
    runs: int | None = None,
    run_seconds: float | None = None,
) -> OutcomeCosts:
    answered = (0 if outcome is Outcome.FAILED else cells) if runs is None else runs
    return OutcomeCosts(
        stage, scenario, outcome, audited, cells, seconds, answered, seconds if run_seconds is None else run_seconds
    )


ANALYSIS = [
    _costs("S1", Outcome.SIMULATED, 300, 3.0, stage=StageName.SENSITIVITY),
    _costs("S2", Outcome.SIMULATED, 300, 6.0, stage=StageName.SENSITIVITY),
    _costs("S2", Outcome.REPEATED, 20, 0.0, stage=StageName.SENSITIVITY, run_seconds=0.4),
    _costs("S2", Outcome.FAILED, 2, 1.0, stage=StageName.SENSITIVITY),
]
CALIBRATION = [
    _costs("S1", Outcome.SIMULATED, 90, 0.9),
    _costs("S1", Outcome.SIMULATED, 10, 0.1, audited=True),
    _costs("S1", Outcome.REPEATED, 40, 0.0, run_seconds=99.0),
    _costs("S1", Outcome.REUSED, 360, 0.0, run_seconds=99.0),
    _costs("S2", Outcome.SIMULATED, 450, 9.0),
    _costs("S2", Outcome.REUSED, 45, 0.0, run_seconds=99.0),
    _costs("S2", Outcome.FAILED, 5, 2.5),
]


@pytest.mark.parametrize(("lost", "times"), [(0, ["124"]), (4, ["120", "124"])])
def test_starts_that_a_kill_may_have_prevented_make_a_range(lost: int, times: list[str]) -> None:
    result = account("c", ["S1", "S2"], CALIBRATION, None, runs_for={"search": 118, "further": 6}, lost=lost)
    assert re.findall(r"\d+", result.remarks[0].partition(":")[0]) == times


def test_the_account_of_a_campaign_with_its_own_map() -> None:
    result = account("c", ["S1", "S2"], ANALYSIS + CALIBRATION, MapOrigin("m", "c", ANALYSIS + CALIBRATION))
    assert {name: value for name, value in result.sensitivity.model_dump().items() if value} == {
        "requested": 622,
        "repeated": 20,
        "simulated": 600,
        "failed": 2,
        "seconds": 10.0,
    }
    first, second = result.scenarios
    assert (first.requested, first.simulated, first.audited) == (500, 100, 10)
    assert first.mean_seconds == pytest.approx(0.01)
    assert first.saved["repeated"] == pytest.approx(0.4)
    assert first.saved["reused"] == pytest.approx(3.6)
    assert (second.requested, second.failed) == (500, 5)
    assert second.mean_seconds == pytest.approx(0.02)
    assert second.saved["reused"] == pytest.approx(0.9)
    assert first.simulated_seconds + second.simulated_seconds == pytest.approx(10.0)
    assert result.saved_seconds == pytest.approx(0.4 + 3.6 + 0.9)
    assert result.net_seconds == pytest.approx(4.9 - 10.0)
    assert result.map is not None
    assert (result.map.made_by, result.map.runs, result.map.seconds) == ("c", 600, 10.0)
    assert result.break_even == 2223
    assert "44.5 % of 1,000" in result.sentence
    assert "net loss of 5.1 s" in result.sentence


def test_predictions_save_and_their_predictor_costs() -> None:
    costs = [
        _costs("S1", Outcome.SIMULATED, 60, 1.2),
        _costs("S1", Outcome.PREDICTED, 40, 0.0, runs=0, run_seconds=0.0),
        _costs("S2", Outcome.SIMULATED, 100, 1.0),
    ]
    result = account("c", ["S1", "S2"], costs, None, predictors={"S1": 0.5, "S2": 0.25}, dispatcher=0.02)
    first, second = result.scenarios
    assert (first.predicted, first.predictor_seconds, second.predicted, second.predictor_seconds) == (40, 0.5, 0, 0.25)
    assert first.saved["predicted"] == pytest.approx(0.8)
    assert "20.0 % of 200" in result.sentence
    assert result.saved_seconds == pytest.approx(0.8)
    assert [(item.name, item.seconds) for item in result.balance[1:]] == [("predictor", -0.75), ("dispatcher", -0.02)]
    assert result.net_seconds == pytest.approx(0.03)


def test_confirmed_answers_are_taken_off_those_that_they_replace() -> None:
    costs = [
        _costs("S1", Outcome.SIMULATED, 10, 1.0),
        _costs("S1", Outcome.REUSED, 2, 0.0),
        _costs("S1", Outcome.PREDICTED, 8, 0.0),
    ]
    confirmed = {"S1": {Outcome.REUSED: 1, Outcome.PREDICTED: 3}}
    (only,) = account("c", ["S1"], costs, None, confirmed=confirmed).scenarios
    assert only.confirmed == 4
    assert only.saved["reused"] == pytest.approx(0.1)
    assert only.saved["predicted"] == pytest.approx(0.5)


def test_a_rerun_pays_nothing_for_the_map_and_counts_what_answered_it() -> None:
    rows = [_costs("S1", Outcome.REPEATED, 300, 0.0, run_seconds=6.0), _costs("S1", Outcome.REUSED, 100, 0.0, run_seconds=2.0)]
    result = account("rerun", ["S1"], rows, MapOrigin("m", "first", ANALYSIS))
    assert result.scenarios[0].mean_seconds == pytest.approx(0.02)
    assert result.saved_seconds == result.net_seconds == pytest.approx(8.0)
    assert (present(result.map).made_by, present(result.map).seconds) == ("first", 10.0)
    assert result.break_even == 2000


def test_a_map_of_a_user_costs_nothing_and_has_no_break_even() -> None:
    result = account("c", ["S1", "S2"], CALIBRATION, MapOrigin("m", None))
    assert (present(result.map).made_by, present(result.map).seconds, result.break_even) == (None, 0.0, None)


def test_a_campaign_without_answers_saves_nothing_yet() -> None:
    result = account("c", ["S1"], ANALYSIS, MapOrigin("m", "c", ANALYSIS))
    assert (result.scenarios[0].mean_seconds, result.break_even, result.net_seconds) == (None, None, -10.0)


def test_a_map_that_saves_nothing_never_pays() -> None:
    result = account(
        "c", ["S1"], [_costs("S1", Outcome.REPEATED, 300, 0.0, run_seconds=6.0)], MapOrigin("m", "first", ANALYSIS)
    )
    assert (result.break_even, any("never" in remark for remark in result.remarks)) == (None, True)


def _waiting(stage: StageName, outcome: Outcome, cells: int, each: float) -> OutcomeCosts:
    """Cells of a simulator that sleeps: 10 ms of CPU time in `each` seconds."""
    own, cpu = cells if outcome is Outcome.SIMULATED else 0, 0.01
    return OutcomeCosts(stage, "S1", outcome, False, cells, own * cpu, cells, cells * cpu, own * each, cells * each)


def test_a_simulator_that_waits_is_accounted_by_the_wall_clock() -> None:
    analysis = [_waiting(StageName.SENSITIVITY, Outcome.SIMULATED, 2, 90.0)]
    costs = [
        *analysis,
        _waiting(StageName.CALIBRATION, Outcome.SIMULATED, 4, 90.0),
        _waiting(StageName.CALIBRATION, Outcome.REPEATED, 6, 90.0),
    ]
    result = account("c", ["S1"], costs, MapOrigin("m", "other", analysis))
    assert result.clock == "wall"
    assert result.scenarios[0].mean_seconds == pytest.approx(90.0)
    assert result.scenarios[0].simulated_seconds == pytest.approx(360.0)
    assert {item.name: item.seconds for item in result.balance} == pytest.approx({"repeated": 540.0, "sensitivity": -180.0})
    assert present(result.map).seconds == pytest.approx(180.0)
    assert result.net_seconds == pytest.approx(360.0)
    assert (result.cpu_seconds, result.wall_seconds) == pytest.approx((0.12, 1080.0))
    assert "by the wall clock" in result.sentence


@pytest.mark.parametrize("each", [0.015, 0.05])
def test_a_simulator_that_computes_is_accounted_by_cpu_time(each: float) -> None:
    """The way to a child and back takes longer than a short run, and is no waiting."""
    costs = [
        _waiting(StageName.CALIBRATION, Outcome.SIMULATED, 4, each),
        _waiting(StageName.CALIBRATION, Outcome.REPEATED, 6, each),
    ]
    result = account("c", ["S1"], costs, None)
    assert result.clock == "cpu"
    assert result.scenarios[0].mean_seconds == pytest.approx(0.01)
    assert "mostly waits" not in result.sentence

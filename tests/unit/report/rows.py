"""Plain data that figures and pages are made from."""

from typing import Any

from drivecal.contracts.accounting import Accounting, BalanceItem, BreakEven, ScenarioAccount, SensitivityCost
from drivecal.contracts.campaign import Baseline, Best, Campaign, CellCounts, ErrorRate, Seconds, Study
from drivecal.contracts.results import CampaignResults, ResultTrust, StudyResult
from drivecal.contracts.setup import CampaignSetup, ScenarioSetup, SearchedParameter
from drivecal.contracts.tables import BoxTrial, Generation, InfluenceRow, OptimumRow, RobustnessRow, Solution, ValidationRow
from drivecal.report.data import ReportData


def row(
    scenario: str = "S1", parameter: str = "P1", lower: float | None = 0, upper: float | None = 10, **given: Any
) -> InfluenceRow:
    """Of a parameter from 0 to 10 s, influential everywhere."""
    known: dict[str, Any] = {"influential": True, "unit": "s", "space_lower": 0, "space_upper": 10, "n_values": 11}
    return InfluenceRow(**{"scenario": scenario, "parameter": parameter, "lower": lower, "upper": upper, **known, **given})


def nowhere(scenario: str, parameter: str) -> InfluenceRow:
    """Of a parameter without influence."""
    return row(scenario, parameter, None, None, influential=False)


ROWS = [
    row("S1", "P1"),
    row("S1", "P2", 2, 7.5),
    nowhere("S1", "P3"),
    nowhere("S2", "P1"),
    row("S2", "P2", 5, 10),
    row("S2", "P3", 4, 4),
]


def generation(iteration: int, **given: Any) -> Generation:
    """60 cells, of which 40 are requested: 24 simulated (4 of them as audits), 10 reused, 5 repeated, 1 failed."""
    known: dict[str, Any] = {
        "proposed": 60, "carried_over": 20, "requested": 40, "repeated": 5, "reused": 10, "simulated": 24, "failed": 1,
        "audited": 4, "best": 5.0 + iteration, "mean": 3.0, "minimum": 1.0, "alternatives": 2,
    }  # fmt: skip
    return Generation(**{"iteration": iteration, **known, **given})


ACCOUNT = Accounting(
    campaign="0" * 32,
    state="succeeded",
    sensitivity=SensitivityCost(requested=500, simulated=450, repeated=50, seconds=9.0),
    map=None,
    scenarios=[
        ScenarioAccount(
            scenario=scenario, requested=40, repeated=5, reused=10, simulated=24, failed=1, audited=4, mean_seconds=0.02,
            simulated_seconds=0.48, audited_seconds=0.08, saved={"repeated": 0.1, "reused": 0.2},
        )
        for scenario in ("S1", "S2")
    ],
    requested=80, answered_without_simulation=30, simulated=48, audited=8, share_without_simulation=0.375, share_reused=0.25,
    simulated_seconds=0.96, audited_seconds=0.16,
    saved_seconds=0.6, net_seconds=-8.4, map_net_seconds=-8.6,
    break_even=BreakEven(requested_cells=1800, campaigns=23, reruns=22),
    balance=[BalanceItem(name="reused", label="reused cells", seconds=0.4),
             BalanceItem(name="sensitivity", label="analysis", seconds=-9.0)],
    remarks=["The influence map pays from 1,800 requested cells on."],
    sentence="It lost 8.4 s.",
)  # fmt: skip


PARAMETERS = [
    SearchedParameter(name="P1", unit="dB", lower=-10, upper=10, n_values=21, fixed=None),
    SearchedParameter(name="P2", unit="1", lower=0, upper=5, n_values=11, fixed=None),
    SearchedParameter(name="P3", unit="s", lower=0, upper=10, n_values=11, fixed=4),
]
SETUP = CampaignSetup(
    evaluator="reference 1",
    parameters=PARAMETERS,
    scenarios=[
        ScenarioSetup(
            scenario="S1", title="Change lane", weight=0.75, fingerprint="f1",
            driving_function="frenet 1", vehicle="single_track 1",
            vehicle_parameters={"mass": 2060.0}, simulator="libsumo 1.28.0", step_seconds=0.1, seed=1,
        ),
        ScenarioSetup(scenario="S2", weight=0.25, fingerprint="f2"),
    ],
    server="0.1.0",
)  # fmt: skip


def optimum(rank: int, p1: float, p2: float, region: int = 0, to_worse: float | None = 0.2) -> OptimumRow:
    """A set that shares the best objective, 6."""
    return OptimumRow(
        rank=rank, objective=6, rating=6 - rank / 10, parameters={"P1": p1, "P2": p2, "P3": 4}, scores={"S1": 5, "S2": 7}, reused=["S2"],
        iteration=0, individual=rank, region=region, to_worse=to_worse,
    )  # fmt: skip


OPTIMA = [optimum(1, 1, 2.5), optimum(2, 1, 5, region=1, to_worse=0.5), optimum(3, 1, 3, to_worse=0.1)]


def trial(box: int, holds: bool, s1: float | None, s2: float | None = 0.0) -> BoxTrial:
    """The box of half width box / 10."""
    return BoxTrial(box=box, radius=box / 10, holds=holds, deviations={"S1": s1, "S2": s2})


def robust(rank: int, degree: int, trials: list[BoxTrial], **given: Any) -> RobustnessRow:
    """An examined set: the one of OPTIMA with the same rank."""
    known: dict[str, Any] = {
        "objective": 6.0, "rating": 5.0 + rank / 10, "parameters": OPTIMA[rank - 1].parameters, "scores": {"S1": 5, "S2": 7}, "region": 0,
        "to_worse": 0.2, "at_least": all(one.holds for one in trials), "recommended": rank == 1,
        "radius": max((one.radius for one in trials if one.holds), default=0.0), "reason": "the best" if rank == 1 else None,
    }  # fmt: skip
    return RobustnessRow(**{"rank": rank, "degree": degree, "trials": trials, **known, **given})


ROBUST = [
    robust(1, 2, [trial(1, True, 0), trial(2, True, 1)]),
    robust(2, 1, [trial(1, True, 0), trial(2, False, 3, 2)]),
    robust(3, 0, [trial(1, False, None)], objective=5.5),
]


def study(stage: str = "robustness", campaign: str = "0" * 32, vehicle: str | None = None, **settings: Any) -> Study:
    """Who made a study, with the settings that the texts need."""
    known = {"condition": "max", "eta": 1.0, "delta": 0.1, "steps": 2, "samples": 4}
    return Study(
        campaign=campaign,
        name="study",
        stage=stage,
        state="succeeded",
        settings={**known, **settings},
        vehicle=vehicle,
        ended_at=None,
    )


def validated(scenario: str, histogram: dict[int, int], reducible: int = 2) -> ValidationRow:
    """20 bases with 5 variants each, or what the histogram says."""
    compared = sum(histogram.values())
    wrong = sum(count for points, count in histogram.items() if abs(points) > 1)
    return ValidationRow(
        scenario=scenario, reducible=reducible, effects=2**reducible - 1, covered=2**reducible - 1, drawn=40, bases=compared // 5,
        references=5, compared=compared, wrong=wrong, different=compared - histogram.get(0, 0),
        error_rate=wrong / compared if compared else None,
        lower_95=0.0 if compared else None, upper_95=0.5 if compared else None, histogram=histogram,
    )  # fmt: skip


VALIDATED = [validated("S1", {0: 90, -1: 4, 2: 5, -7: 1}), validated("S2", {}, reducible=0)]


CAMPAIGN = Campaign(
    id="0" * 32,
    name="a <b>small</b> study",
    state="succeeded",
    stages={
        "calibration": CellCounts(
            proposed=120, carried_over=40, requested=80, repeated=10, reused=20, simulated=48, failed=2, audited=8
        )
    },
    error_rate={"S1": ErrorRate(audited=8, different=1, wrong=1, upper_95=0.5265), "S2": ErrorRate()},
    best=Best(objective=6.0, parameters={"P1": 1, "P2": 2.5, "P3": 4}, scores={"S1": 5, "S2": 7}, alternatives=3),
    baseline=Baseline(objective=None, parameters={"P1": 5, "P2": 5, "P3": 5}, scores={"S1": 4, "S2": None}),
    seconds=Seconds(wall=12, simulating=10),
    notes=["not simulated because their weight is 0: S3"],
    spec={"name": "study", "sensitivity": {"intervals": 5}},
)
WORSE = Solution(
    rank=4,
    objective=5,
    rating=5.9,
    parameters={"P1": -10, "P2": 0, "P3": 4},
    scores={"S1": 5, "S2": 5},
    iteration=0,
    individual=3,
)
STUDIES = [
    StudyResult(study=study(), robustness=ROBUST),
    StudyResult(study=study("validation", "1" * 32), validation=VALIDATED),
]


def results(**given: Any) -> CampaignResults:
    """Returns the results of a small campaign, whole."""
    known: dict[str, Any] = {
        "campaign": CAMPAIGN,
        "setup": SETUP,
        "trust": ResultTrust(light=None, verdicts=[]),
        "accounting": ACCOUNT,
        "studies": STUDIES,
    }
    return CampaignResults(**{**known, **given})


def findings(found: CampaignResults | None = None, **given: Any) -> ReportData:
    """Returns the data of a report on it."""
    known: dict[str, Any] = {
        "results": found or results(),
        "optima": OPTIMA,
        "generations": [generation(0), generation(1)],
        "solutions": [*OPTIMA, WORSE],
        "influence": ROWS,
    }
    return ReportData(**{**known, **given})

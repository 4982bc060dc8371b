"""Plain data that figures and pages are made from."""

from __future__ import annotations

from typing import Any

from drivecal.contracts.accounting import Accounting, BreakEven, ScenarioAccount, SensitivityCost
from drivecal.contracts.campaign import Baseline, Best, Campaign, CellCounts, ErrorRate, Generation, Seconds, Solution
from drivecal.contracts.inventory import InfluenceRow
from drivecal.report.findings import Findings


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
        "proposed": 60, "carried_over": 20, "requested": 40, "repeated": 5, "reused": 10, "certified": 0, "simulated": 24, "failed": 1,
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
            scenario=scenario, requested=40, repeated=5, reused=10, certified=0, simulated=24, failed=1, audited=4, mean_seconds=0.02,
            simulated_seconds=0.48, audited_seconds=0.08, repeated_saved_seconds=0.1, reused_saved_seconds=0.2, certified_saved_seconds=0.0,
        )
        for scenario in ("S1", "S2")
    ],
    requested=80, answered_without_simulation=30, simulated=48, audited=8, share_without_simulation=0.375, share_reused=0.25,
    simulated_seconds=0.96, audited_seconds=0.16, repeated_saved_seconds=0.2, reused_saved_seconds=0.4, certified_saved_seconds=0.0,
    saved_seconds=0.6, net_seconds=-8.4, map_net_seconds=-8.6,
    break_even=BreakEven(requested_cells=1800, campaigns=23, reruns=22),
    sentence="It lost 8.4 s.",
)  # fmt: skip


def findings(**given: Any) -> Findings:
    """A small campaign, whole."""
    campaign = Campaign(
        id="0" * 32,
        name="a <b>small</b> study",
        state="succeeded",
        cells=CellCounts(
            proposed=120, carried_over=40, requested=80, repeated=10, reused=20, simulated=48, failed=2, audited=8
        ),
        error_rate={"S1": ErrorRate(audited=8, different=1, wrong=1, upper_95=0.5265, stopped=True), "S2": ErrorRate()},
        best=Best(objective=6.0, parameters={"P1": 1, "P2": 2.5, "P3": 4}, scores={"S1": 5, "S2": 7}, alternatives=3),
        baseline=Baseline(objective=None, parameters={"P1": 5, "P2": 5, "P3": 5}, scores={"S1": 4, "S2": None}),
        seconds=Seconds(wall=12, simulating=10),
        notes=["not simulated because their weight is 0: S3"],
        spec={"name": "study", "sensitivity": {"intervals": 5}},
    )
    solution = Solution(
        rank=1,
        objective=6,
        rating=5.9,
        parameters={"P1": 1, "P2": 2.5, "P3": 4},
        scores={"S1": 5, "S2": 7},
        iteration=0,
        individual=3,
    )
    known: dict[str, Any] = {
        "campaign": campaign,
        "generations": [generation(0), generation(1)],
        "solutions": [solution],
        "influence": ROWS,
        "basis": None,
        "titles": {"S1": "Change lane", "S2": "Keep the lane"},
        "accounting": ACCOUNT,
    }
    return Findings(**{**known, **given})

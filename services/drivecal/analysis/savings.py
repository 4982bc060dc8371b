"""Savings and costs of reuse: the simulations that it saved, and the time that it took. Pure.

Runs that occupy their workers for much longer than they compute are accounted in wall-clock time, all others in CPU time. Their simulator
waits (for a licence, a device, another machine), or other processes take its processors: an account cannot tell which.

The net estimates the CPU time of the same campaign without reuse, less its own. So a saved cell is worth the mean CPU time of the
scenario's simulations, and all that reuse itself takes is deducted: the sensitivity stage, the predictor, and the dispatcher's look-ups,
keys and lots (the API does nothing for it). Audited cells are simulated
like any other: they are a saving forgone, already missing among the reused, and not a cost on top; so are the samples of predicted lots.
Reused cells that were simulated after the search to confirm its best set save nothing either.

A further outcome that saves simulations goes into `SAVING`; a further cost into the balance.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil

from drivecal.contracts.results import Accounting, BalanceItem, MapCost, ScenarioAccount, SensitivityCost
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Outcome, OutcomeCosts

SAVING = (Outcome.REPEATED, Outcome.REUSED, Outcome.PREDICTED)
"""Outcomes without a simulation. `ScenarioAccount` has a count of each."""
WAITING = 2.0
"""Quotient of wall-clock and CPU time of the runs above which an account is in wall-clock time."""
LEAST_WAIT = 0.05
"""Mean seconds without CPU time of such a run: a shorter one is mostly on its way to a child process and back, which is no waiting."""
ROUNDING = 1e-9
"""Quotients this close above a whole number are that number."""


@dataclass(frozen=True, slots=True)
class MapOrigin:
    """The influence map in use. The campaign `made_by` made it (None: a user posted it), with these `costs` of its cells."""

    id: str
    made_by: str | None
    costs: Sequence[OutcomeCosts] = ()


def account(
    campaign: str,
    scenarios: Iterable[str],
    costs: Sequence[OutcomeCosts],
    origin: MapOrigin | None,
    confirmed: Mapping[str, Mapping[Outcome, int]] | None = None,
    predictors: Mapping[str, float] | None = None,
    dispatcher: float = 0.0,
    runs_for: Mapping[str, int] | None = None,
    lost: int = 0,
) -> Accounting:
    """Returns the account of a campaign.

    Args:
        campaign: its id.
        scenarios: its scenarios, in the order of the account.
        costs: the costs of its cells.
        origin: the influence map in use.
        confirmed: number of cells that were simulated after the search, by scenario and first answer.
        predictors: CPU time of the predictor, by scenario.
        dispatcher: CPU time of the dispatcher for reuse, besides the predictors.
        runs_for: starts of the simulator by what they were for.
        lost: starts, among them, that a kill may have prevented.
    """
    cpu_seconds, wall_seconds = sum(cost.run_seconds for cost in costs), sum(cost.occupied_run_seconds for cost in costs)
    runs = sum(cost.runs for cost in costs)
    waits = wall_seconds > max(WAITING * cpu_seconds, cpu_seconds + LEAST_WAIT * runs)
    if waits:
        costs = _by_the_wall(costs)
        origin = None if origin is None else replace(origin, costs=_by_the_wall(origin.costs))
    rows = [
        _scenario(
            name,
            [cost for cost in costs if cost.stage is StageName.CALIBRATION and cost.scenario == name],
            (confirmed or {}).get(name, {}),
            (predictors or {}).get(name, 0.0),
        )
        for name in scenarios
    ]
    sensitivity = sensitivity_cost(costs)
    used = None if origin is None else _map_cost(origin)
    savings = {outcome.value: sum(row.saved[outcome] for row in rows) for outcome in SAVING}
    balance = [
        *(BalanceItem(name=name, label=f"{name} cells", seconds=seconds) for name, seconds in savings.items()),
        BalanceItem(name="sensitivity", label="sensitivity stage", seconds=-sensitivity.seconds),
        BalanceItem(name="predictor", label="predictor", seconds=-sum(row.predictor_seconds for row in rows)),
        BalanceItem(name="dispatcher", label="dispatcher", seconds=-dispatcher),
    ]
    requested, saved = sum(row.requested for row in rows), savings[Outcome.REUSED]
    accounting = Accounting(
        clock="wall" if waits else "cpu",
        cpu_seconds=cpu_seconds,
        wall_seconds=max(wall_seconds, cpu_seconds),
        sensitivity=sensitivity,
        map=used,
        scenarios=rows,
        runs=runs_for or {},
        saved_seconds=sum(savings.values()),
        net_seconds=sum(item.seconds for item in balance),
        break_even=ceil(used.seconds / saved * requested - ROUNDING) if used is not None and used.seconds and saved else None,
        balance=[item for item in balance if item.seconds],
        sentence="",
    )
    return accounting.model_copy(update={"sentence": _sentence(accounting), "remarks": _remarks(accounting, lost, campaign)})


def _by_the_wall(costs: Iterable[OutcomeCosts]) -> list[OutcomeCosts]:
    """Returns costs whose seconds are those for which workers were occupied."""
    return [replace(row, seconds=max(row.seconds, row.occupied_seconds), run_seconds=row.occupied_run_seconds) for row in costs]


def sensitivity_cost(costs: Iterable[OutcomeCosts]) -> SensitivityCost:
    """Returns the cost of the sensitivity stage."""
    stage = [cost for cost in costs if cost.stage is StageName.SENSITIVITY]
    cells = _cells(stage)
    return SensitivityCost(
        requested=sum(cells.values()),
        **{outcome.value: number for outcome, number in cells.items()},
        seconds=sum(cost.seconds for cost in stage),
    )


def _scenario(
    name: str, costs: Sequence[OutcomeCosts], confirmed: Mapping[Outcome, int], predictor_seconds: float
) -> ScenarioAccount:
    cells = _cells(costs)
    simulated = [cost for cost in costs if cost.outcome is Outcome.SIMULATED]
    mean = _mean_seconds(simulated)
    if mean is None:
        mean = _mean_seconds(costs)
    return ScenarioAccount(
        scenario=name,
        requested=sum(cells.values()),
        **{outcome.value: number for outcome, number in cells.items()},
        audited=sum(cost.cells for cost in simulated if cost.audited),
        confirmed=sum(confirmed.values()),
        mean_seconds=mean,
        simulated_seconds=sum(cell.seconds for cell in simulated),
        saved={outcome.value: max(0, cells[outcome] - confirmed.get(outcome, 0)) * (mean or 0.0) for outcome in SAVING},
        predictor_seconds=predictor_seconds,
    )


def _cells(costs: Iterable[OutcomeCosts]) -> Mapping[Outcome, int]:
    cells = dict.fromkeys(Outcome, 0)
    for cost in costs:
        cells[cost.outcome] += cost.cells
    return cells


def _mean_seconds(costs: Sequence[OutcomeCosts]) -> float | None:
    count = sum(cost.runs for cost in costs)
    return sum(cost.run_seconds for cost in costs) / count if count else None


def _map_cost(origin: MapOrigin) -> MapCost:
    made = sensitivity_cost(origin.costs)
    return MapCost(id=origin.id, made_by=origin.made_by, runs=made.simulated, seconds=made.seconds)


def _remarks(accounting: Accounting, lost: int, campaign: str) -> list[str]:
    """Returns sentences about the runs, the map and its break-even."""
    remarks = []
    if accounting.runs:
        runs = " + ".join(f"{count:,} {name}" for name, count in accounting.runs.items())
        most = sum(accounting.runs.values())
        remarks.append(f"The simulator ran {f'{most - lost:,} to ' * (lost > 0)}{most:,} times: {runs}.")
    used = accounting.map
    if used is not None and used.made_by != campaign:
        cost = f" ({used.runs:,} runs, {used.seconds:,.1f} s)" if used.runs else ""
        paid = "is expert knowledge" if used.made_by is None else f"was paid by campaign {used.made_by}"
        remarks.append(f"The influence map {paid}{cost}.")
    if accounting.break_even is not None:
        remarks.append(f"The influence map pays from {accounting.break_even:,} requested cells on.")
    elif used is not None and used.seconds and any(row.requested for row in accounting.scenarios):
        remarks.append("Reuse saved nothing: at this rate the influence map never pays.")
    return remarks


def _sentence(accounting: Accounting) -> str:
    requested, made = sum(row.requested for row in accounting.scenarios), accounting.sensitivity
    if not requested:
        return f"No cell of a search has an answer.{f' The analysis took {made.seconds:,.1f} s.' * (made.requested > 0)}"
    answered = sum(getattr(row, outcome) for row in accounting.scenarios for outcome in SAVING)
    share = f"{100 * answered / requested:.1f} % of {requested:,} requested cells were answered without a simulation"
    clock = "CPU time" if accounting.clock == "cpu" else "the workers' time"
    balance = f"that saved {accounting.saved_seconds:,.1f} s of {clock}"
    runs = f" ({accounting.sensitivity.simulated:,} runs)"
    costs = [
        f"{item.label} {-item.seconds:,.1f} s{runs * (item.name == 'sensitivity')}"
        for item in accounting.balance
        if item.seconds <= -0.05  # else it would be 0.0 s
    ]
    if costs:
        verb = "net saving" if accounting.net_seconds > -0.05 else "net loss"
        balance = f"{balance}, less {', '.join(costs)}: a {verb} of {abs(accounting.net_seconds):,.1f} s"
    if accounting.clock == "wall":
        cpu, wall = f"{accounting.cpu_seconds:,.1f} s of CPU time", f"{accounting.wall_seconds:,.1f} s"
        balance += f", by the wall clock: the runs behind the answers, counted for each answer, took {cpu} in {wall}"
    return f"{share}; {balance}."

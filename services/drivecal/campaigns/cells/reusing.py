"""Forms lots of the cells that references are to answer, so that `reduction.max_error` bounds the wrong answers among them, and checks
reuse.

A reused answer is a prediction by the influence map: it is committed in a lot, and released after the simulation of a sample
(`reduction.lots`, `campaigns.cells.inspection`). Lots depend on stored rows, never on the order of answers.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace

from sqlalchemy import Connection

from drivecal.campaigns.cells.planning import View
from drivecal.contracts.campaign import ErrorRate
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Outcome
from drivecal.domain.events import EventKind
from drivecal.reduction.audit import error_rates, expected_error_rate
from drivecal.reduction.lots import SamplingPlan, best_plan, most_released
from drivecal.storage import audits, events, lots
from drivecal.storage.evaluations import NewEvaluation
from drivecal.storage.lots import NewLot


def form_lots_of_references(
    connection: Connection, view: View, cells: Sequence[NewEvaluation], limit: float, rates: Mapping[str, ErrorRate]
) -> list[NewEvaluation]:
    """Stores a lot for the reused cells of each scenario in a batch, and returns all cells, these with their lots. A `limit` of 1 makes no
    lots.

    An answer is wrong if it is off by more than the scale's tolerance. `rates` are the audits so far; they choose how many errors a sample
    may hold. The sample of a very small lot is the whole lot.
    """
    members: dict[str, list[int]] = defaultdict(list)
    for place, cell in enumerate(cells):
        if cell.plan is Outcome.REUSED:
            members[cell.scenario].append(place)
    if not members or limit >= 1.0:
        return list(cells)
    first, new = cells[0], []
    for scenario, places in members.items():
        plan = best_plan(len(places), limit, expected_error_rate(rates.get(scenario)))
        at = first.iteration, first.individual, scenario
        size = plan.size, plan.sample, plan.acceptance
        new.append(NewLot(*at, *size, view.bench.scale.tolerance, limit, known=0, seconds=0.0, kind=Outcome.REUSED))
    planned = list(cells)
    for places, number in zip(members.values(), lots.insert(connection, view.campaign, new), strict=True):
        for place in places:
            planned[place] = replace(planned[place], lot=number)
    return planned


def check_reuse(
    connection: Connection, view: View, iteration: int, scenarios: Sequence[str], before: Mapping[str, ErrorRate]
) -> dict[str, ErrorRate]:
    """Evaluates the audits of this and all earlier iterations of the calibration, and results that contradict each other. Without an
    influence map, nothing was reused."""
    if view.influence_map is None:
        return error_rates((), scenarios)
    campaign, bench = view.campaign, view.bench
    rater, scale = bench.evaluator_id, bench.scale
    audits.settle(connection, campaign, StageName.CALIBRATION, iteration, rater, scale)
    contradictions = audits.contradictions(connection, campaign, view.influence_map_sequence, rater, view.watermark, scale)
    inspected = lots.verdicts(connection, campaign, Outcome.REUSED)
    counts, bounds = audits.count(connection, campaign, rater, scale), _most_wrong(connection, campaign) if inspected else {}
    rates = error_rates(counts, scenarios, contradictions, inspected, bounds)
    for scenario, rate in rates.items():
        if rate.rejected and not (scenario in before and before[scenario].rejected):
            data = {"scenario": scenario, "wrong": rate.wrong, "audited": rate.audited}
            events.add(connection, campaign, EventKind.LOT_REJECTED, data)
    return rates


def _most_wrong(connection: Connection, campaign: int) -> dict[str, float]:
    """Returns an upper 95 % limit of the share of wrong answers among those that lots of references released, by scenario."""
    plans: dict[str, list[tuple[SamplingPlan, int]]] = defaultdict(list)
    for lot in lots.of_campaign(connection, campaign, Outcome.REUSED):
        if lot.verdict is not None:
            plans[lot.scenario].append((SamplingPlan(lot.size, lot.sample, lot.acceptance), lot.errors or 0))
    released = lots.released_cells(connection, campaign, Outcome.REUSED)
    return {name: min(1.0, most_released(plans[name]) / count) for name, count in released.items()}


def rejected_text(rates: Mapping[str, ErrorRate]) -> str | None:
    """Returns a note on the scenarios in which lots of references were rejected; None without any."""
    rejected = [f"{name} ({rate.rejected} of {rate.lots})" for name, rate in rates.items() if rate.rejected]
    if not rejected:
        return None
    return f"lots of reused answers had too many wrong samples, so every cell of them was simulated: {', '.join(rejected)}"

"""Answers of the cells: outcomes, errors, savings."""

from collections.abc import Sequence

from drivecal.contracts.accounting import Accounting
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.evaluation import FailureCause
from drivecal.report.markup import paragraph, table
from drivecal.report.rows import (
    FAILURES,
    LOTS,
    LOTS_NOTE,
    OUTCOMES,
    Number,
    error_rates,
    exceeds_limit,
    failure_causes,
    percent,
    released_lots,
    totals,
)
from drivecal.report.sections.savings import seconds_of

CHECKS = {"audited": "of simulated: audits", "sampled": "samples of predictions", "checked": "checks of certificates"}
PROVED = ("proved", "proved_different", "proved_wrong")


def cells_by_stage(campaign: Campaign) -> str:
    """Returns the table of the campaign's cells by outcome and stage."""
    fields = {"proposed": "proposed", "carried_over": "carried over", "requested": "requested"}
    fields |= {outcome: outcome for outcome in OUTCOMES} | CHECKS
    stages = {stage: cells for stage, cells in campaign.by_stage().items() if cells.requested}
    rows = [[title, *(getattr(cells, field, None) for cells in stages.values())] for field, title in fields.items()]
    return table(["cells", *stages], rows, "Cells by outcome and stage") if stages else ""


def self_check(campaign: Campaign, account: Accounting | None) -> list[str]:
    """Returns the results of audits, of inspected lots, of checked certificates, and of certificates of reused cells."""
    header = ["scenario", "audited", "different", "wrong", "R_err", "95 % bound", "contradictions", "lots", "rejected", "reuse"]
    tolerated = campaign.scale.amount(campaign.scale.tolerance)
    wrong = f"wrong: the scores differ by more than {tolerated}"
    lots = "a lot of references with too many wrong samples was rejected, and every cell of it simulated"
    limit = "bound: of the share of wrong answers among those that lots released, without lots of R_err"
    caption = f"Self-check: reusable cells that were simulated all the same; {wrong}; {lots}; {limit}"
    rows = error_rates(campaign.error_rate)
    content = [table(header, rows, caption)] if rows else []
    predicted = lots_table(campaign)
    if not rows and (campaign.cells.reused or not predicted):
        content = [paragraph("No cell was audited, so nothing is known about errors of reuse in this campaign.")]
    return [*content, *predicted, *_proved(account), *_certified(campaign)]


def lots_table(campaign: Campaign, label: str = "") -> list[str]:
    """Returns the table of inspected lots by scenario; nothing without lots. `label` follows the first words of its caption."""
    rows = released_lots(campaign.released)
    header = [*LOTS[:-1], "95 % bound"]
    caption = (
        f"Predicted answers{label}: a sample of each lot was simulated, then it was released or all of it simulated. Asked: batches in "
        "which the predictor was; beyond tolerance: samples; limit: of the expected errors released, for each prediction in a lot. A set "
        "with a predicted score is not ranked"
    )
    note = [paragraph(f"The {LOTS_NOTE}.")] if exceeds_limit(campaign.released) else []
    return [table(header, rows, caption), *note] if rows else []


def failures(causes: Sequence[FailureCause]) -> list[str]:
    """Returns the table of causes of failed cells; nothing without one."""
    caption = "Failed cells by cause. The example is a cell's number: drivecal explain CAMPAIGN EXAMPLE"
    return [table(list(FAILURES), failure_causes(causes), caption)] if causes else []


def proved(account: Accounting | None) -> tuple[int, ...]:
    """Returns the number of reused cells with a certificate of their own result, of different scores, and of wrong scores."""
    return totals([] if account is None else account.scenarios, *PROVED)


def _proved(account: Accounting | None) -> list[str]:
    if account is None or not proved(account)[0]:
        return []
    rows = [
        [
            *(getattr(scenario, name) for name in ("scenario", "reused", *PROVED)),
            percent(scenario.proved_wrong / scenario.proved if scenario.proved else None),
        ]
        for scenario in account.scenarios
        if scenario.reused
    ]
    header = ["scenario", "reused", "proved", "different", "wrong", "R_err"]
    caption = (
        "Self-check without a simulation: reused cells for which a worker happened to know, by a certificate, what a simulation "
        "would have given. Another campaign like this one may know of others"
    )
    return [table(header, rows, caption)]


def _certified(campaign: Campaign) -> list[str]:
    certified, checked = totals(campaign.stages.values(), "certified", "checked")
    if not certified and not checked:
        return []
    text = (
        f"{certified:,} cells were answered by certificates: each repeats a run bit for bit, because its planner would take the same "
        "decision at every step, so that no error comes with them."
    )
    if checked:
        text += (
            f" {checked:,} others were simulated all the same to check their certificates; one that differs ends the campaign."
        )
    return [paragraph(text)]


def accounting(account: Accounting | None) -> list[str]:
    """Returns savings and costs, and when the map pays; nothing before the first answered cell."""
    if account is None:
        return []
    rows = [[item, Number(f"{round(seconds, 1) + 0.0:,.1f}")] for item, seconds in seconds_of(account)]
    clock = "CPU" if account.clock == "cpu" else "wall-clock"
    caption = f"Cost accounting, in {clock} time of the workers"
    parts = [paragraph(account.sentence), table(["", f"{clock} seconds"], rows, caption)]
    even = account.break_even
    if even is not None and even.requested_cells is None:
        parts.append(paragraph("Reuse saved nothing, so at this rate the influence map never pays."))
    elif even is not None:
        plural = "" if even.campaigns == 1 else "s"
        campaigns = "" if even.campaigns is None else f", {even.campaigns:,} campaign{plural} like this one"
        parts.append(
            paragraph(f"At this rate the influence map pays from {even.requested_cells:,} requested cells on{campaigns}.")
        )
    return parts

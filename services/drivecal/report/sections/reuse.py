"""Answers of the cells: outcomes, errors, savings."""

from drivecal.contracts.accounting import Accounting
from drivecal.contracts.campaign import Campaign, CellCounts, Released, StageCellCounts
from drivecal.report.markup import Emphasized, Number, paragraph, table
from drivecal.report.sections.savings import seconds_of

OUTCOMES = ("simulated", "repeated", "reused", "predicted", "certified", "failed")
CHECKS = {"audited": "of simulated: audits", "sampled": "samples of predictions", "checked": "checks of certificates"}


def cells_by_stage(campaign: Campaign) -> str:
    """The campaign's cells by outcome."""

    def row(name: str, cells: CellCounts | StageCellCounts) -> list[object]:
        return [
            name,
            *(getattr(cells, name, None) for name in ("proposed", "carried_over", "requested", *OUTCOMES, *CHECKS)),
        ]

    rows = [row(name, cells) for name, cells in campaign.by_stage().items() if cells.requested]
    header = ["stage", "proposed", "carried over", "requested", *OUTCOMES, *CHECKS.values()]
    return table(header, rows, "Cells by stage and outcome", wrap_header=True) if rows else ""


def self_check(campaign: Campaign, account: Accounting | None) -> list[str]:
    """Returns the results of audits, of inspected lots, of checked certificates, and of certificates of reused cells."""
    content = []
    rates = {name: rate for name, rate in campaign.error_rate.items() if rate.audited or rate.stopped or rate.contradictions}
    if rates:
        rows = [
            [
                name,
                rate.audited,
                rate.different,
                rate.wrong,
                Number(f"{rate.wrong / rate.audited:.2%}") if rate.audited else None,
                None if rate.upper_95 is None else Number(f"{rate.upper_95:.2%}"),
                rate.contradictions,
                Emphasized("stopped") if rate.stopped else "on",
            ]
            for name, rate in rates.items()
        ]
        header = ["scenario", "audited", "different", "wrong", "R_err", "95 % bound", "contradictions", "reuse"]
        caption = "Self-check: reusable cells that were simulated all the same; wrong: the scores differ by more than 1"
        content.append(table(header, rows, caption))
    elif not lots(campaign) or campaign.cells.reused:
        content.append(paragraph("No cell was audited, so nothing is known about errors of reuse in this campaign."))
    return [*content, *lots_table(campaign), *_proved(account), *_certified(campaign)]


def lots(campaign: Campaign) -> dict[str, Released]:
    """Inspected lots of predicted answers, by scenario."""
    return {name: released for name, released in campaign.released.items() if released.lots}


def lots_table(campaign: Campaign) -> list[str]:
    """Returns the inspected lots by scenario; nothing without lots."""
    rows = [
        [
            *(name, released.lots, released.rejected, released.predicted, released.sampled, released.different),
            Number(f"{released.limit:.1%}"),
            None if released.upper_95 is None else Number(f"{released.upper_95:.2%}"),
        ]
        for name, released in lots(campaign).items()
    ]
    if not rows:
        return []
    header = ["scenario", "lots", "rejected", "released answers", "sampled", "different", "limit", "95 % bound"]
    caption = (
        "Predicted answers: a sample of each lot was simulated, and the lot released or simulated whole. Different: by more than the "
        "tolerance; limit: of the expected share of errors among the released answers. A set with a predicted score is not ranked"
    )
    return [table(header, rows, caption)]


def proved(account: Accounting | None) -> tuple[int, int, int]:
    """Reused cells of which a certificate says what a simulation would have given, and how many of their references have another score,
    and one that is off by more than 1."""
    rows = [] if account is None else account.scenarios
    known, different, wrong = (sum(getattr(row, name) for row in rows) for name in PROVED)
    return known, different, wrong


PROVED = ("proved", "proved_different", "proved_wrong")


def _proved(account: Accounting | None) -> list[str]:
    if account is None or not proved(account)[0]:
        return []
    rows = [
        [
            scenario.scenario,
            *(getattr(scenario, name) for name in ("reused", *PROVED)),
            Number(f"{scenario.proved_wrong / scenario.proved:.2%}") if scenario.proved else None,
        ]
        for scenario in account.scenarios
        if scenario.reused
    ]
    header = ["scenario", "reused", "proved", "different", "wrong", "R_err"]
    caption = (
        "Self-check without a simulation: reused cells of which a worker happened to know, by a certificate, what a simulation would "
        "have given. Another campaign like this one may know of others"
    )
    return [table(header, rows, caption)]


def _certified(campaign: Campaign) -> list[str]:
    stages = campaign.stages.values()
    certified, checked = sum(cells.certified for cells in stages), sum(cells.checked for cells in stages)
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
    """Savings and costs, and when the map pays; nothing before the first answered cell."""
    if account is None:
        return []
    rows = [[item, Number(f"{round(seconds, 1) + 0.0:,.1f}")] for item, seconds in seconds_of(account)]
    parts = [paragraph(account.sentence), table(["", "CPU seconds"], rows, "Cost accounting, in CPU time of the workers")]
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

"""Confidence in the results of a review sheet: robustness, origin of the answers, trust, lots, audits, validations."""

import json

from drivecal.report.markup import bullets, command, paragraph, subheading, table
from drivecal.report.review.data import Review, ReviewedSet
from drivecal.report.rows import PREDICTIONS, bound, interval_text, percent, predictions
from drivecal.report.sections.reuse import lots_table


def robustness(review: Review) -> list[str]:
    """Returns how far the vehicle may differ before the chosen set loses its scores."""
    parts: list[str] = []
    for label, reviewed in review.labelled().items():
        examined = reviewed.robust
        if examined is None and not any(scenario.vehicle for scenario in reviewed.setup.scenarios):
            reason = "the problem has no vehicle parameters to vary; scenarios can hold the conditions to be robust against"
            parts.append(paragraph(f"Not examined{label}: {reason}."))
            continue
        if examined is None:
            studied = "no robustness study examined this set" if reviewed.robustness else "no robustness study has succeeded"
            parts.append(paragraph(f"Not known{label}: {studied}."))
            parts.append(command(f"drivecal robustness {reviewed.campaign.id}"))
            continue
        studied_in, row = examined
        settings = studied_in.study.settings
        degree = f"{'at least ' if row.at_least else ''}{row.degree}"
        condition = str(settings.get("condition", "max")).replace("_", " ")
        rows: list[list[object]] = [
            ["degree of robustness", degree],
            [
                "half width of the widest box in which the condition holds, in shares of the vehicle parameters' ranges",
                row.radius,
            ],
            ["condition", f"{condition}, eta {json.dumps(settings.get('eta', 1.0))}"],
            ["vehicles in each box", settings.get("samples")],
            ["vehicle model", studied_in.study.vehicle],
            ["recommended by the study", row.reason if row.recommended else "no"],
        ]
        parts.append(table(["", "value"], rows, f"Robustness{label}"))
        parts.append(command(f"drivecal export {studied_in.study.campaign} --table robustness --format json"))
    return parts


def origin(review: Review) -> list[str]:
    """Returns what was simulated, predicted, certified and copied in the whole campaign."""
    parts: list[str] = []
    fields = ("requested", "simulated", "repeated", "certified", "reused", "predicted", "failed")
    for label, reviewed in review.campaigns().items():
        stages = {name: cells for name, cells in reviewed.campaign.by_stage().items() if cells.requested}
        rows = [[name, *(getattr(cells, field, None) for field in fields)] for name, cells in stages.items()]
        header = ["stage", *("copied" if field == "reused" else field for field in fields)]
        parts.append(table(header, rows, f"Cells of the campaign by what answered them{label}"))
        parts.append(command(f"drivecal show {reviewed.campaign.id}"))
    return parts


def sureness(review: Review) -> list[str]:
    """Returns the trust light of each set with its reasons, inspected lots, audits and validations."""
    parts: list[str] = []
    for label, reviewed in review.labelled().items():
        trust = reviewed.trust
        parts.append(subheading(f"Trust{label}"))
        parts.append(paragraph(f"Light: {trust.light or 'open until the end'}.", "light"))
        parts.append(bullets(f"{reason.light}: {reason.text}" for reason in trust.reasons))
        place = f"iteration={reviewed.chosen.iteration}&individual={reviewed.chosen.individual}"
        parts.append(command(f'curl "$DRIVECAL_URL/api/v1/campaigns/{reviewed.campaign.id}/trust?{place}"'))
    for label, reviewed in review.campaigns().items():
        parts += [*_lots(reviewed, label), *_audits(reviewed, label), *_validations(reviewed, label)]
    return parts


def _lots(reviewed: ReviewedSet, label: str) -> list[str]:
    table_of_lots = lots_table(reviewed.campaign, label)
    return [*table_of_lots, command(f"drivecal show {reviewed.campaign.id}")] if table_of_lots else []


def _audits(reviewed: ReviewedSet, label: str) -> list[str]:
    rows = [
        [
            *(name, rate.audited, rate.different, rate.wrong, bound(rate.upper_95), rate.lots, rate.rejected),
            "stopped" if rate.stopped else "on",
        ]
        for name, rate in reviewed.campaign.error_rate.items()
        if rate.audited or rate.stopped or rate.contradictions
    ]
    if not rows:
        return []
    header = ["scenario", "audited", "different", "wrong", "95 % bound", "lots", "rejected", "reuse"]
    caption = f"Audits of copied scores{label}: copies that were simulated all the same; bound: of the share of wrong ones"
    caption += " among those that lots released, without lots among all"
    return [table(header, rows, caption), command(f"drivecal show {reviewed.campaign.id}")]


def _validations(reviewed: ReviewedSet, label: str) -> list[str]:
    parts: list[str] = []
    for studied in reviewed.validation:
        predicted = any(row.released is not None for row in studied.rows)
        if predicted:
            header, rows = PREDICTIONS, predictions(studied.rows)
            caption = f"Validation of released predictions{label}"
        else:
            header = ["scenario", "compared", "different", "wrong", "R_err", "95 % from", "to"]
            rows = [
                [
                    *(row.scenario, row.compared, row.different, row.wrong),
                    *(percent(share) for share in (row.error_rate, row.lower_95, row.upper_95)),
                ]
                for row in studied.rows
            ]
            caption = f"Validation of the influence map{label}"
        intervals = interval_text(studied.rows)
        parts.append(table(header, rows, caption, wrap_header=True))
        parts += [paragraph(intervals)] if intervals else []
        parts.append(command(f"drivecal export {studied.study.campaign} --table validation"))
    return parts

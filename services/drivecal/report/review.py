"""The review sheet: one page about a chosen set, or two, to check, print and sign. A selection of the sections about the results of their
campaigns; each table has below it the command that prints or repeats its numbers."""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from drivecal.contracts.campaign import Baseline
from drivecal.contracts.results import CampaignResults
from drivecal.contracts.setup import SearchedParameter
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.scales import told, unit_text
from drivecal.report import sections
from drivecal.report.blocks import Block, Bullets, CommandLines, Number, Paragraph, Table, amount
from drivecal.report.data import Review, ReviewedSet
from drivecal.report.fronts import front_blocks
from drivecal.report.html import document
from drivecal.report.sheet import UNSEALED, sealed

TASKS = ("Prepared", "Checked", "Released")
MOST_SHOWN = 30
"""Sets of the front in its table, if no more are marked or chosen."""
SHORT = 8
"""Characters of another campaign's id in the table of scores."""
ORIGINS = {
    "simulated": ("simulated", "a run of this very set"),
    "repeated": ("repeats a simulation", "the stored run of this very set"),
    "reused": ("copied", "a stored run of another set; an influence map says that the difference does not matter"),
    "predicted": ("predicted", "a prediction from other runs, released with its lot"),
    "later": ("simulated later", "a run of this very set by another campaign, in the place of a copied or predicted score"),
    "failed": ("no result", "no result after all attempts"),
}
"""Short and long meaning of the outcomes of cells."""
DOUBTS = {"failed", "constraints_broken", "scores_copied"}
"""Codes of verdicts that a sheet begins with."""
Text = Callable[[float], str]


def sheet(review: Review) -> str:
    """Returns the page with the digest of its content. Equal data give equal bytes."""
    named = [each.words for each in review.sets.values()]
    subtitle = (
        "; ".join(f"{label}: {name}" for label, name in zip(review.sets, named, strict=True)) if len(named) > 1 else named[0]
    )
    notes = dict.fromkeys(note for each in review.sets.values() for note in each.results.campaign.notes)
    content: dict[str, Sequence[Block]] = {
        "Question": _question(review),
        "Objectives": _objectives(review),
        "Result": _result(review),
        "Parameters": [_parameters(review)],
        "Front": _front(review),
        "Robustness": _robustness(review),
        "Origin of the results": [
            block for label, each in review.campaigns().items() for block in sections.cells_table(each.results.campaign, label)
        ],
        "Confidence": _confidence(review),
        "Notes": [Bullets(list(notes))] if notes else [],
        "Signatures": _signatures(),
    }
    values = {"query": review.query, "version": review.version, "digest": UNSEALED}
    title = f"Review: {review.first.results.campaign.name}"
    subtitle += f". Written by drivecal {review.version}"
    return sealed(document(title, subtitle, _warnings(review), content, "review.html.jinja", **values))


def _warnings(review: Review) -> list[str]:
    warnings = []
    for each in review.sets.values():
        campaign = each.results.campaign
        if not CampaignState(campaign.state).ended:
            warnings.append(f"Draft: campaign {campaign.id} is {campaign.state}, and its results may change.")
        doubts = [verdict.text for verdict in each.results.trust.verdicts if verdict.code in DOUBTS]
        warnings += [f"{each.words.capitalize()}: {text}" for text in doubts]
    return list(dict.fromkeys(warnings))


def _question(review: Review) -> list[Block]:
    """Returns problem, versions and fingerprints."""
    facts = {label: _facts(reviewed.results) for label, reviewed in review.sets.items()}
    names = dict.fromkeys(name for known in facts.values() for name in known)
    rows = [[name, *(known.get(name) for known in facts.values())] for name in names]
    command = review.commands(lambda each: f"drivecal show {each.id} --json")
    scenarios = [
        sections.scenarios_table(each.results.setup, label, f'curl "$DRIVECAL_URL/api/v1/campaigns/{each.id}/setup"')
        for label, each in review.campaigns().items()
    ]
    return [Table(["", *review.sets], rows, "Campaign and problem", command), *scenarios]


def _facts(results: CampaignResults) -> dict[str, str]:
    campaign, scale = results.campaign, results.campaign.scale
    ended = "" if campaign.ended_at is None else f", ended {campaign.ended_at:%Y-%m-%d %H:%M:%S} UTC"
    facts = {
        "name": campaign.name,
        "campaign": campaign.id,
        "state": f"{campaign.state}{ended}",
        "score": f"{scale.name}, {scale.direction}, {scale.lower:g} to {scale.upper:g}{unit_text(scale.unit)}",
        "tolerance": scale.amount(scale.tolerance),
        **results.setup.settings,
        "rerun of": campaign.rerun_of or "",
    }
    return {name: text for name, text in facts.items() if text}


def _objectives(review: Review) -> list[Block]:
    """Returns objectives and constraints of each campaign."""
    blocks: list[Block] = []
    for label, reviewed in review.campaigns().items():
        rows = [
            [
                *(goal.name, goal.direction, f"{goal.aggregate} over {_shares(goal.scenarios)}"),
                *(goal.unit if goal.unit != "1" else "", goal.tolerance),
            ]
            for goal in reviewed.summary.objectives
        ]
        header = ["objective", "direction", "of the scenarios' values", "unit", "tolerance"]
        blocks.append(Table(header, rows, f"Objectives{label}", f"drivecal front {reviewed.id} --json"))
        constraints = [f"Subject to {each}." for each in reviewed.summary.constraints]
        blocks.append(Bullets(constraints) if constraints else Paragraph("No constraints."))
    return blocks


def _shares(weights: Mapping[str, float]) -> str:
    if len(set(weights.values())) == 1:
        return f"{', '.join(weights)}{' with equal weights' if len(weights) > 1 else ''}"
    return ", ".join(f"{name} ({weight:.4g})" for name, weight in weights.items())


def _result(review: Review) -> list[Block]:
    """Returns the chosen sets against the baseline, by objective and by scenario, with the origin of each score."""
    sets, listing = review.sets, review.commands(lambda each: each.listing)
    head = ["baseline", *sets, "B less A" if len(sets) > 1 else "change"]
    goals = list(dict.fromkeys(goal.name for each in sets.values() for goal in each.summary.objectives))
    rows = [
        _compared(name, review.first.baseline_of(name), [each.objectives.get(name) for each in sets.values()]) for name in goals
    ]
    blocks: list[Block] = [Table(["objective", *head], rows, "Objectives of the chosen set", listing)]
    bounds = list(dict.fromkeys(name for each in sets.values() for name in each.chosen.constraints))
    if bounds:
        known = {} if review.first.summary.baseline is None else review.first.summary.baseline.constraints
        rows = [
            _compared(name, known.get(name), [each.chosen.constraints.get(name) for each in sets.values()]) for name in bounds
        ]
        blocks.append(Table(["constraint on", *head], rows, "Constrained amounts of the chosen set", listing))
    baseline = review.first.results.campaign.baseline
    scores = [
        [
            *_compared(name, _score(baseline, name), [each.chosen.scores.get(name) for each in sets.values()], told),
            *(_origin(each, name) for each in sets.values()),
        ]
        for name in dict.fromkeys(name for each in sets.values() for name in each.chosen.scores)
    ]
    scale = review.first.results.campaign.scale
    better = "higher" if scale.sign > 0 else "lower"
    caption = f"Score by scenario: {scale.name}{unit_text(scale.unit, ', ')}, {better} is better; origin: the cell that it is taken from"
    header = ["scenario", *head, *(f"origin{label}" for label in review.labelled())]
    used = dict.fromkeys(cell.outcome for each in sets.values() for cell in each.cells.values())
    meanings = [f"{ORIGINS[outcome][0].capitalize()}: {ORIGINS[outcome][1]}." for outcome in used if outcome in ORIGINS]
    commands = [] if baseline is None else [f"{_evaluation(review.first, baseline.parameters)}    # the baseline"]
    command = "\n".join([review.commands(_drives), *commands])
    return [*blocks, Table(header, scores, caption, command), Bullets(meanings)]


def _score(baseline: Baseline | None, scenario: str) -> float | None:
    return None if baseline is None else baseline.scores.get(scenario)


def _compared(name: str, baseline: float | None, values: Sequence[float | None], text: Text | None = None) -> list[object]:
    """Returns the values of the baseline and the sets, and the difference of the last value from the value before."""
    reference = baseline if len(values) == 1 else values[0]
    shown = [amount(value) if text is None or value is None else Number(text(value)) for value in (baseline, *values)]
    last = values[-1]
    return [name, *shown, None if reference is None or last is None else Number(f"{last - reference:+.6g}")]


def _origin(reviewed: ReviewedSet, scenario: str) -> str | None:
    cell = reviewed.cells.get(scenario)
    if cell is None:
        return None
    place = "" if cell.campaign is None else f" of campaign {cell.campaign[:SHORT]}"
    return f"{ORIGINS.get(cell.outcome, (cell.outcome, ''))[0]} ({cell.number}{place})"


def _drives(reviewed: ReviewedSet) -> str:
    numbers: dict[str, list[str]] = {}
    for cell in reviewed.cells.values():
        numbers.setdefault(cell.campaign or reviewed.id, []).append(str(cell.number))
    explained = (
        f"for cell in {' '.join(cells)}; do drivecal explain {campaign} $cell; done" for campaign, cells in numbers.items()
    )
    return "\n".join([_evaluation(reviewed, reviewed.chosen.parameters), *explained])


def _evaluation(reviewed: ReviewedSet, values: sections.Values) -> str:
    scenarios = [scenario.scenario for scenario in reviewed.results.setup.scenarios]
    return sections.evaluation_command(values, reviewed.results.campaign.spec, scenarios)


def _parameters(review: Review) -> Table:
    known: dict[str, SearchedParameter] = {}
    for reviewed in review.sets.values():
        known |= {each.name: known.get(each.name, each) for each in reviewed.results.setup.parameters}
    baseline = review.first.results.campaign.baseline
    values: dict[str, sections.Values] = {"baseline": {} if baseline is None else baseline.parameters}
    values |= {label: each.chosen.parameters for label, each in review.sets.items()}

    def export(reviewed: ReviewedSet) -> str:
        row = f"--table {reviewed.table} --row {reviewed.chosen.rank}"
        return f"drivecal export {reviewed.id} {row} --format cdfx -o set.cdfx"

    return sections.parameters_table(known.values(), values, review.commands(export))


def _front(review: Review) -> list[Block]:
    """Returns the fronts; nothing for a single objective."""
    from drivecal.report.figures import drawing, front  # matplotlib takes a second

    blocks: list[Block] = []
    for each in review.campaigns().values():
        if len(each.summary.objectives) > 1 and each.front:
            chosen = {other.chosen.rank for other in review.sets.values() if (other.id, other.table) == (each.id, "front")}
            drawn = front.drawn(each.front, each.summary, chosen)
            figure = drawing.in_page(drawn, drawing.svg(drawn.figure, drawn.name))
            blocks += front_blocks(each.front, each.summary, each.id, [figure], MOST_SHOWN, chosen)
    return blocks


def _robustness(review: Review) -> list[Block]:
    """Returns how far the vehicle may differ before the chosen set loses its scores."""
    blocks: list[Block] = []
    for label, reviewed in review.labelled().items():
        studies = reviewed.results.of_stage("robustness")
        rows = [(study, row) for study in studies for row in study.robustness if row.parameters == reviewed.chosen.parameters]
        if not rows:
            studied = "no robustness study examined this set" if studies else "no robustness study has succeeded"
            if not any(scenario.vehicle for scenario in reviewed.results.setup.scenarios):
                studied = "the problem has no vehicle parameters to vary"
            blocks.append(Paragraph(f"Not known{label}: {studied}."))
            continue
        study, row = rows[0]
        settings: Mapping[str, Any] = study.study.settings
        facts: list[list[object]] = [
            ["degree of robustness", f"{'at least ' if row.at_least else ''}{row.degree}"],
            ["half width of the widest box that holds, in shares of the vehicle parameters' ranges", row.radius],
            [
                "condition",
                f"{str(settings.get('condition', 'max')).replace('_', ' ')}, eta {json.dumps(settings.get('eta', 1.0))}",
            ],
            ["vehicles in each box", settings.get("samples")],
            ["vehicle model", study.study.vehicle],
            ["recommended by the study", row.reason if row.recommended else "no"],
        ]
        command = f"drivecal export {study.study.campaign} --table robustness --format json"
        blocks.append(Table(["", "value"], facts, f"Robustness{label}", command))
    return blocks


def _confidence(review: Review) -> list[Block]:
    """Returns the light of each set with its verdicts, inspected lots, audits and validations."""
    blocks: list[Block] = []
    for label, each in review.labelled().items():
        place = f"iteration={each.chosen.iteration}&individual={each.chosen.individual}"
        blocks += sections.trust_blocks(each.results.trust, label)
        blocks.append(CommandLines(f'curl "$DRIVECAL_URL/api/v1/campaigns/{each.id}/results?{place}"'))
    for each in review.campaigns().values():
        campaign, command = each.results.campaign, f"drivecal show {each.id}"
        blocks += sections.lots_table(campaign.released, command)
        blocks += sections.audits_table(campaign.error_rate, campaign.scale, command)
        for study in each.results.studies:
            if study.validation:
                export = f"drivecal export {study.study.campaign} --table validation"
                blocks += sections.validation_tables(study.validation, campaign.scale, export)
    return blocks


def _signatures() -> list[Block]:
    meaning = (
        "The digest below, at the foot of each printed page and in the file itself, identifies this content. It proves no author: a "
        "signature is one on paper beside the digest, or one of the file by your own tools. The command computes the digest again, asks "
        "the campaign for the same sheet, and names each number that differs."
    )
    verify = f"echo {UNSEALED}    # SHA-256 of this file with zeros in its place\ndrivecal review --verify FILE"
    rows = [[task, "", "", ""] for task in TASKS]
    return [Table(["Task", "Name", "Date", "Signature"], rows, kind="sign"), Paragraph(meaning), CommandLines(verify)]

"""The report as one page: a selection of the sections about a campaign's results."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from drivecal.contracts.campaign import Baseline, Best, Campaign
from drivecal.contracts.tables import RobustnessRow
from drivecal.domain.scales import objective_text, told
from drivecal.report import sections
from drivecal.report.blocks import (
    Block,
    Bullets,
    CommandLines,
    Figure,
    FileLinks,
    Heading,
    Number,
    Paragraph,
    Table,
    objective_number,
)
from drivecal.report.data import ReportData
from drivecal.report.fronts import front_blocks
from drivecal.report.html import document
from drivecal.report.robustness import robustness_blocks

SPECIFICATION = "campaign.json"
SUMMARY = {"converged", "not_converged", "map_wrong", "map_validated", "predictions_validated"}
"""Codes of verdicts in the summary."""
MOST_CHARACTERS = 10_000
"""Settings of a specification on the page; the file has all."""


def page(findings: ReportData, drawn: Mapping[str, Figure], names: Sequence[str], version: str) -> str:
    """Returns the page.

    Args:
        findings: the data of the report.
        drawn: its figures by name.
        names: files to link to, relative to the page.
        version: of drivecal.
    """
    results, campaign = findings.results, findings.results.campaign

    def figures(prefix: str) -> list[Figure]:
        return [figure for name, figure in drawn.items() if name.startswith(prefix)]

    command = f"drivecal show {campaign.id}"
    alternatives = len(findings.optima) if campaign.best is None else campaign.best.alternatives
    optima = sections.optima_blocks(findings.optima, alternatives, results.setup.parameters, figures("figure-12-optima"))
    content: dict[str, Sequence[Block]] = {
        "Summary": _summary(findings),
        "Notes": [Bullets(campaign.notes)] if campaign.notes else [],
        "Trust": sections.trust_blocks(results.trust),
        "Problem": _problem(findings),
        "Where parameters matter": sections.influence_blocks(findings.influence, findings.basis, figures("figure-9-"), campaign)
        if findings.influence or _searches(campaign)
        else [],
        "Search": _search(findings, figures("figure-10-")),
        "Reuse": [
            *figures("figure-11-"),
            *sections.cells_table(campaign),
            *sections.audits_table(campaign.error_rate, campaign.scale, command),
            *sections.lots_table(campaign.released, command),
            *sections.failures_table(results.failures),
        ],
        "Best sets": [*optima, *sections.solutions_table(findings.solutions, findings.optima)] if findings.optima else [],
        "Front": front_blocks(findings.front, results.front, campaign.id, figures("figure-front")) if results.front else [],
        "Robustness": _robustness(findings, figures("figure-12-robustness")),
        "Validation": _validation(findings, figures("figure-14-")),
        "Cost": sections.account_blocks(results.accounting),
        "Repetition": _repetition(findings),
        "Files": [FileLinks(names)] if names else [],
    }
    subtitle = f"campaign {campaign.id}, {campaign.state}{_when(campaign)}; drivecal {version}"
    return document(campaign.name, subtitle, (campaign.error, campaign.degraded), content)


def _when(campaign: Campaign) -> str:
    if campaign.ended_at is not None:
        return f", ended {campaign.ended_at:%Y-%m-%d %H:%M} UTC after {campaign.seconds.wall:,.0f} s"
    return "" if campaign.started_at is None else f", started {campaign.started_at:%Y-%m-%d %H:%M} UTC"


def _searches(campaign: Campaign) -> bool:
    return campaign.spec.get("optimizer", {}) is not None


def _summary(findings: ReportData) -> list[Block]:
    results, campaign, best = findings.results, findings.results.campaign, findings.results.campaign.best
    row = results.recommended
    studies = [] if row is None else [f"Recommended after the robustness study: rank {row.rank}, because it has {row.reason}."]
    if best is None:
        nothing = (
            "No parameter set has a result in every scenario." if _searches(campaign) else "This campaign searched nothing."
        )
        return [Bullets(studies) if studies else Paragraph(nothing)]
    regions = len({optimum.region for optimum in findings.optima})
    least = "at least " * (len(findings.optima) < best.alternatives)
    where = f", in {least}{regions} distinct regions" if regions > 1 else ""
    share = "1 parameter set has it" if best.alternatives == 1 else f"{best.alternatives:,} parameter sets share it{where}"
    first = f"The best objective is {objective_text(best.objective)} ({sections.objective_words(campaign)}); {share}."
    if campaign.baseline is not None and campaign.baseline.objective is not None:
        first += f" The baseline has {objective_text(campaign.baseline.objective)}."
    verdicts = [each.text for each in results.trust.verdicts if each.code in SUMMARY]
    cost = [] if results.accounting is None else [results.accounting.sentence]
    return [Bullets([first, *verdicts, *cost, *studies]), _compared(findings, best)]


def _compared(findings: ReportData, best: Best) -> Table:
    sets = _sets(findings)
    rows: list[list[object]] = [["objective", *(objective_number(each.objective) for each in sets.values())]]
    for scenario in best.scores:
        scores = [each.scores.get(scenario) for each in sets.values()]
        rows.append([scenario, *(None if score is None else Number(told(score)) for score in scores)])
    caption = "Objective and scores: the best set, that of the robustness study, and the baseline, as far as they are known"
    return Table(["", *sets], rows, caption)


def _sets(findings: ReportData) -> dict[str, Best | RobustnessRow | Baseline]:
    results = findings.results
    sets = {"best": results.campaign.best, "recommended": results.recommended, "baseline": results.campaign.baseline}
    return {name: each for name, each in sets.items() if each is not None}


def _problem(findings: ReportData) -> list[Block]:
    setup = findings.results.setup
    values = {name: each.parameters for name, each in _sets(findings).items()}
    return [
        sections.scenarios_table(setup),
        sections.parameters_table(setup.parameters, values),
        Table(["", "settings"], list(setup.settings.items()), "Settings", wrap=True),
    ]


def _search(findings: ReportData, drawings: Sequence[Block]) -> list[Block]:
    campaign, generations = findings.results.campaign, findings.generations
    if not generations:
        return [Paragraph("There is no iteration (yet).")] if _searches(campaign) else []
    wanted = (campaign.spec.get("optimizer") or {}).get("iterations")
    added = campaign.cells.requested - sum(generation.requested for generation in generations)
    if len(generations) != wanted or added <= 0:
        return [*drawings]
    text = f"After the last iteration {added:,} cells were asked for to confirm the best set by simulation. Iterations do not count them."
    return [*drawings, Paragraph(text)]


def _robustness(findings: ReportData, drawings: Sequence[Block]) -> list[Block]:
    results = findings.results
    studies = results.of_stage("robustness")
    if studies:
        return robustness_blocks(studies, findings.optima, results.campaign, drawings)
    if not findings.optima or not any(scenario.vehicle for scenario in results.setup.scenarios):
        return []
    command = CommandLines(f"drivecal robustness {results.campaign.id}")
    return [Paragraph("Not studied. This drives the best sets in other vehicles:"), command]


def _validation(findings: ReportData, drawings: Sequence[Block]) -> list[Block]:
    results, scale = findings.results, findings.results.campaign.scale
    blocks: list[Block] = []
    for study in results.of_stage("validation", of_predictions=True)[:1]:
        blocks += sections.validation_tables(study.validation, scale)
    for study in results.of_stage("validation")[:1]:
        return [*blocks, *sections.validation_tables(study.validation, scale), *drawings]
    if findings.influence:
        command = CommandLines(f"drivecal validate {results.campaign.id}")
        blocks += [Paragraph("Not studied. This compares, by simulation, what the map calls equal:"), command]
    return blocks


def _repetition(findings: ReportData) -> list[Block]:
    """Returns the commands that repeat the campaign and drive its best and its recommended set alone."""
    results, campaign = findings.results, findings.results.campaign
    recommended = results.recommended
    commands = [f"drivecal submit {SPECIFICATION} --wait"]
    text = (
        f"The file {SPECIFICATION} beside this page is the campaign's specification with all its defaults. With the versions above and the "
        "same reference table it gives the same sets and scores; what the table holds by then is answered from it."
    )
    sensitivity: Any = campaign.spec.get("sensitivity")
    if isinstance(sensitivity, dict) and "map" in sensitivity:
        text += " It names an influence map by its id, which another database does not have: post it there first."
    scenarios = [scenario.scenario for scenario in results.setup.scenarios]
    if campaign.best is not None:
        best = sections.evaluation_command(campaign.best.parameters, campaign.spec, scenarios)
        commands.append(f"{best}    # the best set")
    if recommended is not None:
        driven = results.of_stage("robustness")[0].study.vehicle
        command = sections.evaluation_command(recommended.parameters, campaign.spec, scenarios, driven)
        commands.append(f"{command}    # the recommended set")
    blocks: list[Block] = [Paragraph(text), CommandLines("\n".join(commands))]
    lines = (f"  {json.dumps(name)}: {json.dumps(value, ensure_ascii=False)}" for name, value in campaign.spec.items())
    specification = "{\n" + ",\n".join(lines) + "\n}"
    return blocks if len(specification) > MOST_CHARACTERS else [*blocks, Heading("Specification"), CommandLines(specification)]

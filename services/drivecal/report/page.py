"""The report as one page."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from drivecal.contracts.campaign import Campaign, CellCounts, SensitivityCellCounts, Solution
from drivecal.contracts.inventory import InfluenceRow
from drivecal.report.accounts import seconds_of
from drivecal.report.findings import Findings
from drivecal.report.markup import Emphasized, Number, document, figure, heading, link, paragraph, section, table
from drivecal.report.spider import by_scenario

OUTCOMES = ("simulated", "repeated", "reused", "certified", "failed")


def page(findings: Findings, figures: Iterable[tuple[str, str, str]], files: Sequence[str], version: str) -> str:
    """The page. `figures`: name, caption and inline SVG of those that stand in it; `files`: paths to link to, relative to the page."""
    campaign = findings.campaign
    drawn = {
        name: figure(svg, caption, [f"figures/{name}.{form}" for form in ("svg", "png")]) for name, caption, svg in figures
    }
    spiders = [html for name, html in drawn.items() if name.startswith("figure-9-")]
    parts = [
        heading(campaign.name),
        paragraph(f"campaign {campaign.id}, {campaign.state}{_when(campaign)}; drivecal {version}", "sub"),
        *(paragraph(text, "warn") for text in (campaign.error, campaign.degraded, *campaign.notes) if text),
        section("Result", *_result(findings)),
        section("Where parameters matter", *_influence(findings), *spiders),
        section("Search", drawn.get("figure-10-population", paragraph("There is no iteration (yet)."))),
        section("Reuse", drawn.get("figure-11-cells", ""), *_cells(campaign), *_errors(campaign), *_accounting(findings)),
        section("Problem", *_problem(campaign)),
        section("Files", "<ul>" + "".join(f"<li>{link(file, file)}</li>" for file in files) + "</ul>"),
    ]
    return document(campaign.name, parts)


def _when(campaign: Campaign) -> str:
    if campaign.ended_at is not None:
        return f", ended {campaign.ended_at:%Y-%m-%d %H:%M} UTC after {campaign.seconds.wall:,.0f} s"
    return "" if campaign.started_at is None else f", started {campaign.started_at:%Y-%m-%d %H:%M} UTC"


def _result(findings: Findings) -> list[str]:
    best, baseline = findings.campaign.best, findings.campaign.baseline
    if best is None:
        return [paragraph("No parameter set has a result in every scenario.")]
    share = "1 parameter set has it" if best.alternatives == 1 else f"{best.alternatives:,} parameter sets share it"
    rows = [_set_row("best", best.objective, best.scores, best.parameters, best.scores, best.parameters)]
    if baseline is not None:
        rows.append(
            _set_row("baseline", baseline.objective, baseline.scores, baseline.parameters, best.scores, best.parameters)
        )
    header = ["", "objective", *best.scores, *best.parameters]
    return [
        paragraph(f"The best objective is {best.objective:.4f} of 7; {share}."),
        table(header, rows, "The best set: its score (0 to 7) in each scenario and its parameter values"),
        _solutions(findings.solutions),
    ]


def _set_row(
    name: str,
    objective: float | None,
    scores: Mapping[str, int | None] | Mapping[str, int],
    parameters: Mapping[str, float],
    scenarios: Iterable[str],
    names: Iterable[str],
) -> list[object]:
    shown = None if objective is None else Number(f"{objective:.4f}")
    return [name, shown, *(scores.get(one) for one in scenarios), *(parameters.get(one) for one in names)]


def _solutions(solutions: Sequence[Solution]) -> str:
    if not solutions:
        return ""
    first = solutions[0]
    return table(
        ["rank", "objective", "rating", *first.scores, *first.parameters],
        [
            [
                one.rank,
                Number(f"{one.objective:.4f}"),
                Number(f"{one.rating:.3f}"),
                *one.scores.values(),
                *one.parameters.values(),
            ]
            for one in solutions
        ],
        f"The {len(solutions)} best sets; equal objectives are ordered by the continuous rating",
    )


def _influence(findings: Findings) -> list[str]:
    if not findings.influence:
        return [paragraph("No influence map is in use, so only equal parameter sets are answered without a simulation.")]
    scenarios = by_scenario(findings.influence)
    cells = {(row.scenario, row.parameter): _bounds(row) for row in findings.influence}
    names = list(dict.fromkeys(row.parameter for row in findings.influence))
    rows = [[name, *(cells.get((scenario, name)) for scenario in scenarios)] for name in names]
    caption = "Influential bounds in parameter units, inclusive; a dash where nothing is influential"
    return [paragraph(_origin(findings.basis)), table(["parameter", *scenarios], rows, caption)]


def _origin(basis: Mapping[str, Any] | None) -> str:
    if basis is None:
        return "The influence map was posted by a user; no analysis stands behind it."
    settings = basis["sensitivity"]
    return (
        f"An analysis by elementary effects: design {settings['design']}, {settings['intervals']} intervals, {settings['samples']} "
        f"samples, threshold {json.dumps(settings['threshold'])}, seed {settings['seed']}; {basis['runs']:,} runs asked for, "
        f"{basis['simulated']:,} simulated for it."
    )


def _bounds(row: InfluenceRow) -> str | None:
    if not row.influential:
        return None
    if row.unknown:
        return Emphasized("unknown")
    if (row.lower, row.upper) == (row.space_lower, row.space_upper):
        return Emphasized("everywhere")
    return Emphasized(" … ".join("" if end is None else f"{end:g}" for end in (row.lower, row.upper)))


def _cells(campaign: Campaign) -> list[str]:
    def row(name: str, cells: CellCounts | SensitivityCellCounts) -> list[object]:
        return [name, *(getattr(cells, one, None) for one in ("proposed", "carried_over", "requested", *OUTCOMES, "audited"))]

    stages: dict[str, CellCounts | SensitivityCellCounts] = {
        "sensitivity": campaign.sensitivity_cells,
        "calibration": campaign.cells,
    }
    rows = [row(name, cells) for name, cells in stages.items() if cells.requested]
    header = ["stage", "proposed", "carried over", "requested", *OUTCOMES, "of simulated: audits"]
    return [table(header, rows, "Cells by outcome")] if rows else []


def _errors(campaign: Campaign) -> list[str]:
    rates = {name: rate for name, rate in campaign.error_rate.items() if rate.audited or rate.stopped or rate.contradictions}
    if not rates:
        return [paragraph("No cell was audited, so nothing is known about errors of reuse in this campaign.")]
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
    return [table(header, rows, caption)]


def _accounting(findings: Findings) -> list[str]:
    found = findings.accounting
    if found is None:
        return []
    rows = [[item, Number(f"{seconds:,.1f}")] for item, seconds in seconds_of(found)]
    parts = [paragraph(found.sentence), table(["", "CPU seconds"], rows, "Cost accounting, in CPU time of the workers")]
    even = found.break_even
    if even is not None and even.requested_cells is None:
        parts.append(paragraph("Nothing was reused, so at this rate the influence map never pays."))
    elif even is not None:
        campaigns = "" if even.campaigns is None else f", {even.campaigns:,} campaigns like this one"
        parts.append(
            paragraph(f"At this rate the influence map pays from {even.requested_cells:,} requested cells on{campaigns}.")
        )
    return parts


def _problem(campaign: Campaign) -> list[str]:
    rows = [[name, json.dumps(value, ensure_ascii=False)] for name, value in campaign.spec.items() if name != "name"]
    return [
        table(["", ""], rows, wrap=True),
        paragraph("The same again, from the file beside this page:"),
        "<pre>drivecal submit campaign.json --wait</pre>",
    ]

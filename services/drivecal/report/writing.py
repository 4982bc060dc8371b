"""A campaign's report: its figures, tables and page."""

import json
from collections.abc import Iterable, Iterator, Mapping
from importlib.metadata import version
from pathlib import Path

from drivecal.report import PAGE
from drivecal.report.data import ReportData
from drivecal.report.figures import cells, front, optima_coordinates, population, robustness_degrees
from drivecal.report.figures.drawing import Drawn
from drivecal.report.figures.spider import overview_figures, scenario_figure
from drivecal.report.folder import writable
from drivecal.report.page import page
from drivecal.report.rows import by_scenario
from drivecal.report.sections import robustness, savings, validation


def write_report(
    findings: ReportData, tables: Mapping[str, Iterable[bytes]], folder: Path, *, page_alone: bool = False
) -> list[Path]:
    """Writes page, figures, the `tables` (CSV by name, in pieces) and the specification. Returns the written files, the page last.
    `page_alone`: writes the page only, without links to files.

    Raises InvalidInputError if a file cannot be written.
    """
    with writable(folder, page_alone=page_alone) as target:
        drawn = {figure.name: target.draw(figure) for figure in figures(findings)}
        for name, pieces in tables.items():
            target.write(f"tables/{name}.csv", pieces)
        if findings.robustness:
            target.table("robustness-boxes", robustness.boxes(findings.robustness[0]))
        if findings.accounting is not None:
            target.table("accounting", savings.by_scenario(findings.accounting))
            target.table("balance", savings.balance(findings.accounting))
        document = json.dumps(findings.campaign.spec, indent=2, ensure_ascii=False)
        target.write("campaign.json", [document.encode() + b"\n"])
        target.write(PAGE, [page(findings, drawn, target.files, version("drivecal")).encode()])
    return target.written


def figures(findings: ReportData) -> Iterator[Drawn]:
    """Yields Figures 9 to 12 and 14 of the paper for this campaign, and its front, without empty ones."""
    yield from _influence(findings)
    if findings.generations:
        baseline = findings.campaign.baseline
        yield population.drawn(findings.generations, None if baseline is None else baseline.objective)
    if any(generation.requested for generation in findings.generations):
        yield cells.drawn(findings.generations)
    if findings.optima:
        chosen = findings.recommended
        values = None if chosen is None else chosen.parameters
        yield optima_coordinates.drawn(findings.optima, findings.solutions, findings.setup.parameters, values)
    if findings.front_summary is not None and len(findings.front_summary.objectives) > 1 and findings.front:
        yield front.drawn(findings.front, findings.front_summary)
    if findings.robustness:
        yield from robustness_degrees.drawn(findings.robustness)
    if findings.validation:
        yield from validation.drawn(findings.validation[0].rows, findings.campaign.scale)


def _influence(findings: ReportData) -> Iterator[Drawn]:
    if not findings.influence:
        return
    caption = (
        "Where each parameter can change the score of each scenario: from its lower bound at the hub to its upper bound at "
        "the rim. A parameter without a grey segment has no influence anywhere."
    )
    scenarios = by_scenario(findings.influence)
    alt = "Spider plots; " + "; ".join(
        f"in {name} {sum(row.influential for row in rows)} of {len(rows)} parameters are influential"
        for name, rows in scenarios.items()
    )
    for number, sheet in enumerate(overview_figures(findings.influence, findings.titles), 1):
        name = "figure-9-influence" if number == 1 else f"figure-9-influence-{number}"
        yield Drawn(name, caption, sheet, alt=alt)
    for scenario, rows in scenarios.items():
        title = findings.titles.get(scenario, "")
        yield Drawn(f"figure-9-{scenario}", title, scenario_figure(rows, title), in_page=False)

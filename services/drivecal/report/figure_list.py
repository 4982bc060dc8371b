"""Figures of a campaign's report."""

from collections.abc import Iterator

from drivecal.report.data import ReportData
from drivecal.report.figures import cells, optima_coordinates, population, robustness_degrees
from drivecal.report.figures.drawing import Drawn
from drivecal.report.figures.spider import by_scenario, overview_figures, scenario_figure
from drivecal.report.sections import validation


def figures(findings: ReportData) -> Iterator[Drawn]:
    """Figures 9 to 12 and 14 of the paper for this campaign; those that there is nothing to draw for are left out."""
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
    if findings.robustness:
        yield from robustness_degrees.drawn(findings.robustness)
    if findings.validation:
        yield from validation.drawn(findings.validation[0].rows)


def _influence(findings: ReportData) -> Iterator[Drawn]:
    if not findings.influence:
        return
    caption = (
        "Figure 9. Where each parameter can change the score of each scenario: from its lower bound at the hub to its upper bound at "
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

"""Which figures a campaign's report has."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from matplotlib.figure import Figure

from drivecal.report.cells import cells_figure
from drivecal.report.findings import Findings
from drivecal.report.population import population_figure
from drivecal.report.spider import by_scenario, overview_figures, scenario_figure


@dataclass(frozen=True, slots=True)
class Drawn:
    """A figure, the `name` of its files, and whether it stands in the page itself."""

    name: str
    caption: str
    figure: Figure
    in_page: bool


def figures(findings: Findings) -> Iterator[Drawn]:
    """Figures 9, 10 and 11 of the paper for this campaign; those that there is nothing to draw for are left out."""
    if findings.influence:
        caption = (
            "Figure 9. Where each parameter can change the score of each scenario: from its lower bound at the hub to its upper bound at "
            "the rim. A parameter without a grey segment has no influence anywhere."
        )
        for number, sheet in enumerate(overview_figures(findings.influence, findings.titles), 1):
            name = "figure-9-influence" if number == 1 else f"figure-9-influence-{number}"
            yield Drawn(name, caption, sheet, in_page=True)
        for scenario, rows in by_scenario(findings.influence).items():
            title = findings.titles.get(scenario, "")
            yield Drawn(f"figure-9-{scenario}", title, scenario_figure(rows, title), in_page=False)
    if findings.generations:
        baseline = findings.campaign.baseline
        caption = (
            "Figure 10. Left: the objectives of the population in each iteration. Right: how many distinct parameter sets had been found "
            "by then with the best objective by then."
        )
        figure = population_figure(findings.generations, None if baseline is None else baseline.objective)
        yield Drawn("figure-10-population", caption, figure, in_page=True)
    if any(one.requested for one in findings.generations):
        caption = (
            "Figure 11. Requested cells, one parameter set in one scenario each, added up over the iterations by what answered them. What "
            "the optimizer carried over unchanged is not requested; the runs of the sensitivity analysis are not in it."
        )
        yield Drawn("figure-11-cells", caption, cells_figure(findings.generations), in_page=True)

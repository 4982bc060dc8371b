"""The report as one page."""

from collections.abc import Mapping, Sequence

from drivecal.contracts.campaign import Campaign
from drivecal.report.data import ReportData
from drivecal.report.figures import cells
from drivecal.report.markup import bullets, document, files, paragraph, verbatim
from drivecal.report.rows import by_scenario
from drivecal.report.sections import front, influence, optima, problem, results, reuse, robustness, search, validation


def page(findings: ReportData, drawn: Mapping[str, str], names: Sequence[str], version: str) -> str:
    """Returns the page. `drawn`: the figures as parts of it, by name. `names`: files to link to, relative to the page."""
    campaign = findings.campaign
    sections = {
        "Summary": results.summary(findings),
        "Notes": [bullets(campaign.notes)] if campaign.notes else [],
        "Trust": results.trust(findings),
        "Problem": problem.setting(findings),
        "Where parameters matter": _influence(findings, drawn),
        "Search": _search(findings, drawn),
        "Reuse": _reuse(findings, drawn),
        "Best sets": _best(findings, drawn),
        "Front": front.parts(findings.front, findings.front_summary, campaign.id, _figures(drawn, "figure-front")),
        "Robustness": _robustness(findings, drawn),
        "Validation": _validation(findings, drawn),
        "Cost": reuse.accounting(findings.accounting),
        "Versions and repetition": [*problem.versions(findings.setup, version), *problem.again(findings)],
        "Files": [files(names)] if names else [],
    }
    subtitle = f"campaign {campaign.id}, {campaign.state}{_when(campaign)}; drivecal {version}"
    return document(campaign.name, subtitle, (campaign.error, campaign.degraded), sections)


def _when(campaign: Campaign) -> str:
    if campaign.ended_at is not None:
        return f", ended {campaign.ended_at:%Y-%m-%d %H:%M} UTC after {campaign.seconds.wall:,.0f} s"
    return "" if campaign.started_at is None else f", started {campaign.started_at:%Y-%m-%d %H:%M} UTC"


def _figures(drawn: Mapping[str, str], prefix: str) -> list[str]:
    return [html for name, html in drawn.items() if name.startswith(prefix) and html]


def _searched(campaign: Campaign) -> bool:
    return campaign.spec.get("optimizer", {}) is not None


def _influence(findings: ReportData, drawn: Mapping[str, str]) -> list[str]:
    if not findings.influence and not _searched(findings.campaign):
        return []
    return influence.parts(findings.influence, findings.basis, _figures(drawn, "figure-9-"), findings.campaign.cells)


def _search(findings: ReportData, drawn: Mapping[str, str]) -> list[str]:
    if not findings.generations:
        return [paragraph("There is no iteration (yet).")] if _searched(findings.campaign) else []
    converged = search.convergence(findings.generations, findings.front_summary)
    afterwards = search.afterwards(findings.campaign, findings.generations)
    return [
        bullets([*converged, *([afterwards] if afterwards else [])]) if converged else "",
        *_figures(drawn, "figure-10-"),
        search.population_table(findings.generations),
    ]


def _best(findings: ReportData, drawn: Mapping[str, str]) -> list[str]:
    if not findings.optima:
        return []
    best = findings.campaign.best
    alternatives = len(findings.optima) if best is None else best.alternatives
    return [
        *optima.parts(findings.optima, alternatives, findings.setup.parameters, _figures(drawn, "figure-12-optima")),
        results.solutions_table(findings.solutions, findings.optima),
    ]


def _robustness(findings: ReportData, drawn: Mapping[str, str]) -> list[str]:
    identifier = findings.campaign.id
    if findings.robustness:
        drawings = _figures(drawn, "figure-12-robustness")
        return robustness.parts(findings.robustness, findings.optima, findings.campaign, drawings)
    drives = any(scenario.vehicle for scenario in findings.setup.scenarios)
    if not findings.optima or not drives:
        return []
    return [
        paragraph("Not studied. This drives the best sets in other vehicles:"),
        verbatim(f"drivecal robustness {identifier}"),
    ]


def _reuse(findings: ReportData, drawn: Mapping[str, str]) -> list[str]:
    campaign = findings.campaign
    content = [reuse.cells_by_stage(campaign)]
    if campaign.cells.requested:
        content = [
            *_figures(drawn, "figure-11-"),
            cells.cells_table(findings.generations),
            *content,
            *reuse.self_check(campaign, findings.accounting),
        ]
    return [*content, *reuse.failures(findings.failures)]


def _validation(findings: ReportData, drawn: Mapping[str, str]) -> list[str]:
    identifier = findings.campaign.id
    content = [
        part
        for studied in findings.predictions[:1]
        for part in validation.validated_predictions(studied, findings.campaign.scale)
    ]
    if findings.validation:
        drawings = _figures(drawn, "figure-14-")
        return [
            *content,
            *validation.parts(
                findings.validation[0], identifier, by_scenario(findings.influence), drawings, findings.campaign.scale
            ),
        ]
    if not findings.influence:
        return content
    return [
        *content,
        paragraph("Not studied. This compares, by simulation, what the map calls equal:"),
        verbatim(f"drivecal validate {identifier}"),
    ]

"""The files of a report: its page, figures as SVG and PNG, tables as CSV, the specification."""

import json
from collections.abc import Iterable, Iterator
from importlib.metadata import version
from pathlib import Path

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.report import PAGE
from drivecal.report.blocks import Figure
from drivecal.report.data import Report, ReportData
from drivecal.report.figures import front, optima_coordinates, search, studies
from drivecal.report.figures.drawing import Drawn, in_page, png, svg
from drivecal.report.figures.spider import overview_figures
from drivecal.report.page import SPECIFICATION, page


def write(report: Report, folder: Path, *, page_alone: bool = False) -> list[Path]:
    """Writes a report's page, and unless `page_alone` its figures, tables and specification. Returns the files, the page last.

    Raises InvalidInputError if a file cannot be written.
    """
    written: list[Path] = []

    def put(name: str, pieces: Iterable[bytes]) -> None:
        if page_alone and name != PAGE:
            return
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as stream:
            stream.writelines(pieces)
        written.append(path)

    def draw(drawn: Drawn) -> Figure:
        document = svg(drawn.figure, drawn.name)
        names = [] if page_alone else [f"figures/{drawn.name}.svg", f"figures/{drawn.name}.png"]
        for name, content in zip(names, (document.encode(), png(drawn.figure)) if names else (), strict=True):
            put(name, [content])
        return in_page(drawn, document, names)

    try:
        drawn = {figure.name: draw(figure) for figure in figures(report.data)}
        for title, pieces in report.tables.items():
            put(f"tables/{title}.csv", pieces)
        specification = json.dumps(report.data.results.campaign.spec, indent=2, ensure_ascii=False)
        put(SPECIFICATION, [specification.encode() + b"\n"])
        names = [path.relative_to(folder).as_posix() for path in written]
        put(PAGE, [page(report.data, drawn, names, version("drivecal")).encode()])
    except OSError as error:
        where = str(error.filename or folder)
        raise InvalidInputError(Problem(where, f"it cannot be written: {error.strerror}", "give another folder")) from error
    return written


def figures(findings: ReportData) -> Iterator[Drawn]:
    """Yields Figures 9 to 12 and 14 of the paper for this campaign, and its front, without empty ones."""
    results = findings.results
    yield from _influence(findings)
    if findings.generations:
        baseline = results.campaign.baseline
        yield search.population(findings.generations, None if baseline is None else baseline.objective)
    if any(generation.requested for generation in findings.generations):
        yield search.cells(findings.generations)
    if findings.optima:
        values = None if results.recommended is None else results.recommended.parameters
        yield optima_coordinates.drawn(findings.optima, findings.solutions, results.setup.parameters, values)
    if results.front is not None and len(results.front.objectives) > 1 and findings.front:
        yield front.drawn(findings.front, results.front)
    yield from studies.robustness(results.of_stage("robustness"))
    for study in results.of_stage("validation")[:1]:
        yield from studies.validation(study.validation, results.campaign.scale)


def _influence(findings: ReportData) -> Iterator[Drawn]:
    if not findings.influence:
        return
    caption = (
        "Where each parameter can change the score of each scenario: from its lower bound at the hub to its upper bound at "
        "the rim. A parameter without a grey segment has no influence anywhere."
    )
    titles = {scenario.scenario: scenario.title for scenario in findings.results.setup.scenarios}
    for number, sheet in enumerate(overview_figures(findings.influence, titles), 1):
        name = "figure-9-influence" if number == 1 else f"figure-9-influence-{number}"
        yield Drawn(name, caption, sheet)

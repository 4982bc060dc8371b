"""The files of a report: its page, figures as SVG and PNG, tables as CSV, the specification."""

import json
from collections.abc import Iterable, Iterator, Mapping
from importlib.metadata import version
from pathlib import Path

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.report import PAGE
from drivecal.report.blocks import Figure
from drivecal.report.data import Report, ReportData
from drivecal.report.figures import front, optima_coordinates, search, studies
from drivecal.report.figures.drawing import Drawn, in_page, png, svg
from drivecal.report.figures.spider import overview_figures, scenario_figure
from drivecal.report.page import SPECIFICATION, page
from drivecal.report.sections import by_scenario

FORMS = ("svg", "png")


def write(report: Report, folder: Path, *, page_alone: bool = False) -> list[Path]:
    """Writes a report's page, with figures, tables and specification beside it unless `page_alone`. Returns the files, the page last.

    Raises InvalidInputError if a file cannot be written.
    """
    target = _Folder(folder, page_alone=page_alone)
    try:
        drawn = {figure.name: target.draw(figure) for figure in figures(report.data)}
        target.write_tables(report.tables, SPECIFICATION, report.data.results.campaign.spec)
        shown = {name: figure for name, figure in drawn.items() if figure is not None}
        content = page(report.data, shown, target.files, version("drivecal"))
        target.write(PAGE, [content.encode()])
    except OSError as error:
        where = str(error.filename or folder)
        raise InvalidInputError(Problem(where, f"it cannot be written: {error.strerror}", "give another folder")) from error
    return target.written


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
    scenarios = by_scenario(findings.influence)
    alt = "Spider plots; " + "; ".join(
        f"in {name} {sum(row.influential for row in rows)} of {len(rows)} parameters are influential"
        for name, rows in scenarios.items()
    )
    for number, sheet in enumerate(overview_figures(findings.influence, titles), 1):
        name = "figure-9-influence" if number == 1 else f"figure-9-influence-{number}"
        yield Drawn(name, caption, sheet, alt=alt)
    for scenario, rows in scenarios.items():
        title = titles.get(scenario, "")
        yield Drawn(f"figure-9-{scenario}", title, scenario_figure(rows, title), in_page=False)


class _Folder:
    """A folder with the files `written` to it, in order. Replaces the files of an earlier report."""

    def __init__(self, path: Path, *, page_alone: bool) -> None:
        """`page_alone`: writes no file besides the page."""
        self._path = path
        self._page_alone = page_alone
        self.written: list[Path] = []

    @property
    def files(self) -> list[str]:
        """Written files, relative to the folder."""
        return [path.relative_to(self._path).as_posix() for path in self.written]

    def write(self, name: str, pieces: Iterable[bytes]) -> None:
        """Writes a file, `name` relative to the folder."""
        if self._page_alone and name != PAGE:
            return
        path = self._path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as stream:
            for piece in pieces:
                stream.write(piece)
        self.written.append(path)

    def write_tables(self, tables: Mapping[str, Iterable[bytes]], name: str, specification: Mapping[str, object]) -> None:
        """Writes tables as CSV, and a specification as JSON."""
        for title, pieces in tables.items():
            self.write(f"tables/{title}.csv", pieces)
        self.write(name, [json.dumps(specification, indent=2, ensure_ascii=False).encode() + b"\n"])

    def draw(self, drawn: Drawn) -> Figure | None:
        """Writes the files of a figure. Returns the figure as a part of a page, with links to them; None if it is not in the page."""
        document = svg(drawn.figure, drawn.name)
        files = [] if self._page_alone else [f"figures/{drawn.name}.{form}" for form in FORMS]
        if files:
            self.write(files[0], [document.encode()])
            self.write(files[1], [png(drawn.figure)])
        return in_page(drawn, document, files) if drawn.in_page else None

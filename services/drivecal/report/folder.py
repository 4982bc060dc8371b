"""The folder that a report is written to: the page, figures as SVG and PNG, tables as CSV."""

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from html import escape
from pathlib import Path

from markupsafe import Markup

from drivecal.contracts.tables import spreadsheet_text
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.report import PAGE
from drivecal.report.figures.drawing import Drawn, inlined, png, svg
from drivecal.report.markup import figure

FORMS = ("svg", "png")


class Folder:
    """A folder with the files `written` to it, in order. Replaces the files of an earlier report."""

    def __init__(self, path: Path, *, page_alone: bool) -> None:
        """`page_alone`: writes no file besides the page."""
        self.path = path
        self._page_alone = page_alone
        self.written: list[Path] = []

    @property
    def files(self) -> list[str]:
        """Written files, relative to the folder."""
        return [path.relative_to(self.path).as_posix() for path in self.written]

    def write(self, name: str, pieces: Iterable[bytes]) -> None:
        """Writes a file, `name` relative to the folder."""
        if self._page_alone and name != PAGE:
            return
        path = self.path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as stream:
            for piece in pieces:
                stream.write(piece)
        self.written.append(path)

    def table(self, name: str, rows: Iterable[Sequence[object]]) -> None:
        """Writes `tables/name.csv`; the first row is its header."""
        stream = io.StringIO()
        csv.writer(stream).writerows(
            [spreadsheet_text(value) if isinstance(value, str) else value for value in row] for row in rows
        )
        self.write(f"tables/{name}.csv", [stream.getvalue().encode()])

    def draw(self, drawn: Drawn) -> str:
        """Writes the files of a figure. Returns the figure as a part of a page, with links to them."""
        document = svg(drawn.figure, drawn.name)
        files = [] if self._page_alone else [f"figures/{drawn.name}.{form}" for form in FORMS]
        if files:
            self.write(files[0], [document.encode()])
            self.write(files[1], [png(drawn.figure)])
        if not drawn.in_page:
            return ""
        inline = Markup(inlined(document, drawn.name, escape(drawn.alt or drawn.caption)))  # noqa: S704  # matplotlib's own SVG
        return figure(inline, drawn.caption, files)


@contextmanager
def writable(path: Path, *, page_alone: bool = False) -> Iterator[Folder]:
    """Opens a folder to write to. `page_alone`: see `Folder`. Raises InvalidInputError if something cannot be written."""
    try:
        yield Folder(path, page_alone=page_alone)
    except OSError as error:
        where = str(error.filename or path)
        raise InvalidInputError(Problem(where, f"it cannot be written: {error.strerror}", "give another folder")) from error

"""HTML that needs nothing else: no network, no scripts; to be read on a screen and on paper. The markup is in `templates`."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from drivecal.report.rows import Emphasized, Number

SHORT = 16
"""Rows up to which a table stays on one printed page."""


def anchor(title: str) -> str:
    """Returns the id of a section."""
    return "section-" + re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


_ENVIRONMENT = Environment(
    loader=PackageLoader("drivecal.report"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)
_ENVIRONMENT.filters["anchor"] = anchor
_MACROS: Any = _ENVIRONMENT.get_template("markup.html.jinja").module

heading: Callable[[str], str] = _MACROS.heading
subheading: Callable[[str], str] = _MACROS.subheading
contents: Callable[[Iterable[str]], str] = _MACROS.contents
bullets: Callable[[Iterable[str]], str] = _MACROS.bullets
files: Callable[[Iterable[str]], str] = _MACROS.files
verbatim: Callable[[str], str] = _MACROS.verbatim
paragraph: Callable[..., str] = _MACROS.paragraph
figure: Callable[[Markup, str, Sequence[str]], str] = _MACROS.figure
command: Callable[[str], str] = _MACROS.command
drawing: Callable[[Markup, str], str] = _MACROS.drawing


def document(
    title: str,
    subtitle: str,
    warnings: Iterable[str | None],
    sections: Mapping[str, Sequence[str]],
    template: str = "page.html.jinja",
    **values: str,
) -> str:
    """Returns a page. Sections are lists of parts by title; empty ones, and empty warnings, are left out. `values`: of the `template`."""
    kept = {name: section for name, section in sections.items() if section}
    parts = [
        *(heading(title), paragraph(subtitle, "sub"), contents(kept)),
        *(paragraph(text, "warn") for text in warnings if text),
        *(_MACROS.section(name, section) for name, section in kept.items()),
    ]
    return _ENVIRONMENT.get_template(template).render(title=title, parts=parts, **values)


def rendered(template: str, **values: object) -> Markup:
    """Returns a part of a page from a template of its own."""
    return Markup(_ENVIRONMENT.get_template(template).render(**values))  # noqa: S704  # escaped by the template


def table(
    header: Sequence[str],
    rows: Iterable[Sequence[object]],
    caption: str = "",
    *,
    wrap: bool = False,
    wrap_header: bool = False,
) -> str:
    """Returns a table. Columns of numbers are right-aligned; None is a dash. `wrap` breaks long texts into lines; `wrap_header` breaks
    those of the header too, if they are longer than the values."""
    lines = [list(row) for row in rows]
    numeric = [all(isinstance(row[column], (int, float, Number, type(None))) for row in lines) for column in range(len(header))]
    cells = [[(_text(value), isinstance(value, Emphasized)) for value in row] for row in lines]
    html: str = _MACROS.table(header, cells, numeric, caption, len(lines) <= SHORT, wrap, wrap_header)
    return html


def _text(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:,}" if isinstance(value, int) else f"{value:g}" if isinstance(value, float) else str(value)

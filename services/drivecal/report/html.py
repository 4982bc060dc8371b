"""HTML that needs nothing else: no network, no scripts; to be read on a screen and on paper. The markup is in `templates`."""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from drivecal.report.blocks import Block, Bullets, Emphasized, Figure, FileLinks, Heading, Number, Paragraph, Table

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


def document(
    title: str,
    subtitle: str,
    warnings: Iterable[str | None],
    sections: Mapping[str, Sequence[Block]],
    template: str = "page.html.jinja",
    **values: str,
) -> str:
    """Returns a page.

    Args:
        title: its first heading.
        subtitle: the line below it.
        warnings: empty ones are left out.
        sections: blocks by title; empty sections are left out.
        template: the frame of the page; that of review sheets shows the commands of tables.
        values: further values of the template.
    """
    kept = {name: section for name, section in sections.items() if section}
    with_commands = template != "page.html.jinja"
    parts = [
        *(_MACROS.heading(title), _MACROS.paragraph(subtitle, "sub"), _MACROS.contents(kept)),
        *(_MACROS.paragraph(text, "warn") for text in warnings if text),
        *(
            _MACROS.section(name, [_drawn(block, with_commands=with_commands) for block in section])
            for name, section in kept.items()
        ),
    ]
    return _ENVIRONMENT.get_template(template).render(title=title, parts=parts, **values)


def _drawn(block: Block, *, with_commands: bool) -> str:
    """Returns the markup of a block, which the macros have escaped."""
    html: str
    if isinstance(block, Table):
        html = _table(block) + (_MACROS.command(block.command) if with_commands and block.command else "")
    elif isinstance(block, Figure):
        html = _MACROS.figure(block.svg, block.caption, block.files)
    elif isinstance(block, Paragraph):
        html = _MACROS.paragraph(block.text, block.kind)
    elif isinstance(block, Bullets):
        html = _MACROS.bullets(block.items)
    elif isinstance(block, FileLinks):
        html = _MACROS.files(block.names)
    else:
        html = (_MACROS.subheading if isinstance(block, Heading) else _MACROS.verbatim)(block.text)
    return html


def _table(table: Table) -> str:
    lines = [list(row) for row in table.rows]
    places = range(len(table.header))
    numeric = [all(isinstance(row[place], (int, float, Number, type(None))) for row in lines) for place in places]
    cells = [[(cell_text(value), isinstance(value, Emphasized)) for value in row] for row in lines]
    short = len(lines) <= SHORT
    html: str = _MACROS.table(table.header, cells, numeric, table.caption, short, table.wrap, table.wrap_header, table.kind)
    return html


def cell_text(value: object) -> str:
    """Returns the text of a table's cell."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:,}" if isinstance(value, int) else f"{value:g}" if isinstance(value, float) else str(value)

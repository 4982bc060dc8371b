"""HTML that needs nothing else: no network, no scripts; to be read on a screen and on paper. The markup is in `templates`."""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from drivecal.report.blocks import Block, Emphasized, Number, Paragraph, Table

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
        *(_MACROS.title(title), _MACROS.paragraph(Paragraph(subtitle, "sub")), _MACROS.contents(kept)),
        *(_MACROS.paragraph(Paragraph(text, "warn")) for text in warnings if text),
        *(
            _MACROS.section(name, [_drawn(block, with_commands=with_commands) for block in section])
            for name, section in kept.items()
        ),
    ]
    return _ENVIRONMENT.get_template(template).render(title=title, parts=parts, **values)


def _drawn(block: Block, *, with_commands: bool) -> Markup:
    """Returns the markup of a block, which the macros have escaped."""
    macro = getattr(_MACROS, type(block).__name__.lower())
    markup: Markup = macro(block, **_cells(block)) if isinstance(block, Table) else macro(block)
    if with_commands and isinstance(block, Table) and block.command:
        markup += _MACROS.command(block.command)
    return markup


def _cells(table: Table) -> dict[str, Any]:
    lines = [list(row) for row in table.rows]
    places = range(len(table.header))
    return {
        "rows": [[(cell_text(value), isinstance(value, Emphasized)) for value in row] for row in lines],
        "numeric": [all(isinstance(row[place], (int, float, Number, type(None))) for row in lines) for place in places],
        "short": len(lines) <= SHORT,
    }


def cell_text(value: object) -> str:
    """Returns the text of a table's cell."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:,}" if isinstance(value, int) else f"{value:g}" if isinstance(value, float) else str(value)

"""HTML that needs nothing else: no network, no scripts; to be read on a screen and on paper."""

import re
from collections.abc import Iterable, Sequence
from html import escape

STYLE = """
:root { color-scheme: light; }
body { margin: 2rem auto; max-width: 62rem; padding: 0 1rem; color: #222; background: #fff;
  font: 15px/1.5 system-ui, "Segoe UI", Roboto, "DejaVu Sans", Verdana, sans-serif; }
h1 { font-size: 1.7rem; margin: 0 0 .2rem; } h2 { font-size: 1.2rem; margin: 2.2rem 0 .6rem; border-bottom: 1px solid #bbb; }
p.sub { color: #555; margin: 0 0 1.2rem; }
figure { margin: 1rem 0; text-align: center; } figure svg { height: auto; }
figcaption, caption { color: #444; font-size: .87rem; text-align: left; padding: .3rem 0; }
.scroll { overflow-x: auto; } table { border-collapse: collapse; font-size: .87rem; font-variant-numeric: tabular-nums; margin: .6rem 0; }
th, td { padding: .15rem .45rem; border-bottom: 1px solid #ddd; text-align: left; white-space: nowrap; }
th { border-bottom: 1.5px solid #555; } td.n, th.n { text-align: right; } td.on { background: #d6d6d6; }
td.wide { white-space: normal; } th.wide { white-space: normal; vertical-align: bottom; } ul.files { columns: 20rem; padding-left: 1.2rem; }
nav { font-size: .87rem; margin: 0 0 1rem; } nav a { margin-right: 1rem; white-space: nowrap; }
h3 { font-size: 1rem; margin: 1.4rem 0 .3rem; } p { max-width: 48rem; } p.sub { max-width: none; }
pre { background: #f4f4f4; padding: .7rem; font-size: .8rem; white-space: pre-wrap; overflow-wrap: anywhere; }
a { color: #00568a; } .warn { border-left: 4px solid #D55E00; padding-left: .7rem; }
.key { border-left: 4px solid #0072B2; padding-left: .7rem; }
@page { size: A4; margin: 15mm; }
@media print {
  body { margin: 0; max-width: none; padding: 0; font-size: 9.5pt; } figcaption, caption { font-size: 8pt; }
  h1 { font-size: 16pt; } h2 { font-size: 12pt; margin-top: 1.4rem; } figure { margin: .5rem 0; } pre { font-size: 7.5pt; }
  nav { display: none; } a { color: inherit; text-decoration: none; }
  figure, tr, caption, p, .short { break-inside: avoid; } thead { display: table-header-group; } h2, h3, caption { break-after: avoid; }
  .scroll { overflow: visible; } table { font-size: 7.5pt; } th, td { padding: .08rem .22rem; } ul.files { font-size: 8pt; }
}
"""
POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


SHORT = 16
"""Rows up to which a table is not torn apart in print."""


class Emphasized(str):
    """The text of a table's cell that stands out."""

    __slots__ = ()


class Number(str):
    """A number that is written already."""

    __slots__ = ()


def document(title: str, parts: Iterable[str]) -> str:
    """A whole page."""
    body = "\n".join(part for part in parts if part)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{POLICY}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>{escape(title)}</title>
<style>{STYLE}</style>
</head>
<body>
<main>
{body}
</main>
</body>
</html>
"""


def heading(text: str) -> str:
    """The page's own heading."""
    return f"<h1>{escape(text)}</h1>"


def section(title: str, *parts: str) -> str:
    """A part of a page under a heading, which `contents` can point to."""
    head = f'<section id="{anchor(title)}">\n<h2>{escape(title)}</h2>\n'
    return head + "\n".join(part for part in parts if part) + "\n</section>"


def subheading(text: str) -> str:
    """A heading within a section."""
    return f"<h3>{escape(text)}</h3>"


def contents(titles: Iterable[str]) -> str:
    """Links to sections by their titles; not printed."""
    links = "\n".join(f'<a href="#{anchor(title)}">{escape(title)}</a>' for title in titles)
    return f'<nav aria-label="Contents">\n{links}\n</nav>'


def anchor(title: str) -> str:
    """The id of a section."""
    return "section-" + re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def bullets(items: Iterable[str]) -> str:
    """A list of plain sentences."""
    return "<ul>\n" + "\n".join(f"<li>{escape(item)}</li>" for item in items) + "\n</ul>"


def files(names: Iterable[str]) -> str:
    """A list of links to files beside the page."""
    return '<ul class="files">\n' + "\n".join(f"<li>{link(name, name)}</li>" for name in names) + "\n</ul>"


def verbatim(text: str) -> str:
    """Commands, or a document, as they are."""
    return f"<pre>{escape(text)}</pre>"


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text."""
    return f"<p{_class([kind])}>{escape(text)}</p>"


def figure(svg: str, caption: str, files: Sequence[str]) -> str:
    """A drawing with its caption and links to its files."""
    links = ", ".join(link(file, file.rpartition(".")[2].upper()) for file in files)
    return f"<figure>\n{svg}\n<figcaption>{escape(caption)} ({links})</figcaption>\n</figure>"


def link(file: str, text: str) -> str:
    """A link to a file beside the page."""
    return f'<a href="{escape(file)}">{escape(text)}</a>'


def table(
    header: Sequence[str],
    rows: Iterable[Sequence[object]],
    caption: str = "",
    *,
    wrap: bool = False,
    wrap_header: bool = False,
) -> str:
    """Columns of numbers stand to the right; None is a dash. `wrap`: long texts may take several lines; `wrap_header`: those of the
    header as well, where they are longer than what stands below."""
    lines = [list(row) for row in rows]
    right = [all(isinstance(row[column], (int, float, Number, type(None))) for row in lines) for column in range(len(header))]

    def line(tag: str, row: Sequence[object]) -> str:
        opening = '<th scope="col"' if tag == "th" else "<td"
        wide = wrap or (wrap_header and tag == "th")
        cells = [
            f"{opening}{_class(['n' * numeric, 'on' * isinstance(value, Emphasized), 'wide' * wide])}>{escape(_text(value))}</{tag}>"
            for value, numeric in zip(row, right, strict=True)
        ]
        return f"<tr>{''.join(cells)}</tr>"

    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    head = f"<thead>{line('th', header)}</thead>" if any(header) else ""
    body = "\n".join(line("td", row) for row in lines)
    short = " short" * (len(lines) <= SHORT)
    return f'<div class="scroll{short}"><table>{title}{head}<tbody>\n{body}\n</tbody></table></div>'


def _class(names: Iterable[str]) -> str:
    kept = " ".join(name for name in names if name)
    return f' class="{kept}"' if kept else ""


def _text(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:,}" if isinstance(value, int) else f"{value:g}" if isinstance(value, float) else str(value)

"""HTML that needs nothing else: no network, no scripts; to be read on a screen and on paper."""

from __future__ import annotations

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
td.wide { white-space: normal; } ul { columns: 20rem; padding-left: 1.2rem; }
pre { background: #f4f4f4; padding: .7rem; font-size: .8rem; white-space: pre-wrap; overflow-wrap: anywhere; }
a { color: #00568a; } .warn { border-left: 4px solid #D55E00; padding-left: .7rem; }
@page { size: A4; margin: 15mm; }
@media print {
  body { margin: 0; max-width: none; padding: 0; font-size: 10pt; }
  figure, table, tr { break-inside: avoid; } h2 { break-after: avoid; }
  .scroll { overflow: visible; } table { font-size: 8pt; } th, td { padding: .1rem .3rem; }
}
"""
POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


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
{body}
</body>
</html>
"""


def heading(text: str) -> str:
    """The page's own heading."""
    return f"<h1>{escape(text)}</h1>"


def section(title: str, *parts: str) -> str:
    """A part of a page under a heading."""
    return f"<section>\n<h2>{escape(title)}</h2>\n" + "\n".join(part for part in parts if part) + "\n</section>"


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


def table(header: Sequence[str], rows: Iterable[Sequence[object]], caption: str = "", *, wrap: bool = False) -> str:
    """Columns of numbers stand to the right; None is a dash. `wrap`: long texts may take several lines."""
    lines = [list(row) for row in rows]
    right = [all(isinstance(row[column], (int, float, Number, type(None))) for row in lines) for column in range(len(header))]

    def line(tag: str, row: Sequence[object]) -> str:
        cells = [
            f"<{tag}{_class(['n' * numeric, 'on' * isinstance(value, Emphasized), 'wide' * wrap])}>{escape(_text(value))}</{tag}>"
            for value, numeric in zip(row, right, strict=True)
        ]
        return f"<tr>{''.join(cells)}</tr>"

    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    head = f"<thead>{line('th', header)}</thead>" if any(header) else ""
    body = "\n".join(line("td", row) for row in lines)
    return f'<div class="scroll"><table>{title}{head}<tbody>\n{body}\n</tbody></table></div>'


def _class(names: Iterable[str]) -> str:
    kept = " ".join(name for name in names if name)
    return f' class="{kept}"' if kept else ""


def _text(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:,}" if isinstance(value, int) else f"{value:g}" if isinstance(value, float) else str(value)

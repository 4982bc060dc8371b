"""Style of all figures, and their SVG and PNG: same bytes for the same data, readable in print and without colours."""

import io
import re
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from typing import Any, Literal, TypeVar

import matplotlib as mpl
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from drivecal.report.blocks import Figure as Block

DOTS_PER_INCH = 200
PANELS_PER_SHEET = 12
Panel = TypeVar("Panel")
BLUE, SKY, GREEN, VERMILION, ORANGE, PURPLE = "#0072B2", "#56B4E9", "#009E73", "#D55E00", "#E69F00", "#CC79A7"
"""Colours of the palette of Okabe and Ito, distinct for the colour-blind."""
Dashes = Literal["-", "--", "-."] | tuple[float, Sequence[float]]
KINDS: tuple[tuple[str, Dashes], ...] = (
    (BLUE, "-"),
    (VERMILION, "--"),
    (GREEN, "-."),
    (ORANGE, (0, (1, 1))),
    (PURPLE, (0, (5, 1, 1, 1, 1, 1))),
    (SKY, (0, (8, 3))),
)
"""Colour and dashes of lines of several kinds, distinguishable without colours."""
INK, RULE, INFLUENTIAL = "#222222", "#C8C8C8", "#8A8A8A"
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib, so that every machine draws the same
    "font.size": 8,
    "axes.titlesize": 9,
    "axes.labelsize": 8,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": RULE,
    "grid.linewidth": 0.4,
    "text.color": INK,
    "text.parse_math": False,  # names are users', and a dollar sign in one begins no formula
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "hatch.linewidth": 0.5,
    "savefig.facecolor": "white",
    "svg.fonttype": "none",  # text stays text: to be searched, copied and read aloud
}
FALLBACK = "'DejaVu Sans', Verdana, sans-serif"
"""Verdana is as wide as DejaVu Sans, so that labels keep their places if the latter is missing."""


@dataclass(frozen=True, slots=True)
class Drawn:
    """A figure with the `name` of its files."""

    name: str
    caption: str
    figure: Figure


_DRAWING = threading.RLock()
"""Settings of matplotlib belong to the process: one thread draws at a time."""


@contextmanager
def style() -> Iterator[None]:
    """Applies `STYLE` to figures inside the block."""
    with _DRAWING, mpl.rc_context(STYLE):
        yield


def svg(figure: Figure, name: str) -> str:
    """Returns the figure as SVG. `name` keeps its ids apart from the ids of other figures in one page."""
    FigureCanvasSVG(figure)
    stream = io.StringIO()
    with style(), mpl.rc_context({"svg.hashsalt": name}):
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return stream.getvalue().replace("'DejaVu Sans'", FALLBACK)


def png(figure: Figure) -> bytes:
    """Returns the figure as PNG, at print resolution."""
    FigureCanvasAgg(figure)
    stream = io.BytesIO()
    with style():
        figure.savefig(stream, format="png", dpi=DOTS_PER_INCH, metadata={"Software": None})
    return stream.getvalue()


def inlined(document: str, name: str, title: str) -> str:
    """Returns an SVG document as a part of an HTML page: unique ids, no XML head, as wide as the page allows, named for screen readers."""
    body = document[document.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>\s*", "", body, flags=re.DOTALL)
    body = re.sub(r'\bid="', f'id="{name}-', body)
    body = body.replace('href="#', f'href="#{name}-').replace("url(#", f"url(#{name}-")
    body = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", body, count=1)
    width = re.search(r'<svg[^>]*? width="([0-9.]+)pt"', body)
    limit = f' style="max-width: {float(width[1]) * 4 / 3:.0f}px"' if width else ""
    attributes = f' width="100%"{limit} role="img" aria-label="{title}"'
    # By a function: a backslash in the title is not a reference.
    return re.sub(r'(<svg[^>]*?) width="[^"]*"', lambda match: match[1] + attributes, body, count=1)


def in_page(drawn: Drawn, document: str, files: Iterable[str] = ()) -> Block:
    """Returns a figure, whose SVG is known, as a part of a page."""
    inline = Markup(inlined(document, drawn.name, escape(drawn.caption)))  # noqa: S704  # matplotlib's own SVG
    return Block(inline, drawn.caption, list(files))


def sheets(panels: Sequence[Panel]) -> list[Sequence[Panel]]:
    """Returns the panels by sheet."""
    return [panels[start : start + PANELS_PER_SHEET] for start in range(0, len(panels), PANELS_PER_SHEET)]


def plotted(value: float | None) -> float:
    """Returns a value for a line; an unknown value is a gap."""
    return float("nan") if value is None else value


def whole_numbers(axes: Axes) -> None:
    """Puts ticks of the horizontal axis at whole numbers only."""
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))

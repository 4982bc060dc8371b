"""Figure 9: influential ranges, one spider plot per scenario, in the notation of the paper's Figures 5 and 9."""

import math
from collections.abc import Mapping, Sequence
from textwrap import fill

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch, Polygon

from drivecal.contracts.tables import InfluenceRow
from drivecal.domain.scales import unit_text
from drivecal.report.figures.drawing import INFLUENTIAL, INK, RULE, style
from drivecal.report.sections import by_scenario, segment

HUB = 0.2
"""Radius at which the axes begin, of the rim's: at 0 they would cover each other."""
PANELS_PER_SHEET = 12
UNKNOWN = "//////"
"""Hatching of parameters that count as influential because nothing is known about them."""


def scenario_figure(rows: Sequence[InfluenceRow], title: str = "") -> Figure:
    """Draws the spider plot of one scenario with the bounds of its parameters."""
    with style():
        figure = Figure(figsize=(6.3, 5.2))
        axes = figure.add_axes((0.0, 0.055, 1.0, 0.885))
        _spider(axes, rows, with_bounds=True)
        figure.text(0.5, 0.98, rows[0].scenario, ha="center", va="top", fontsize=11, fontweight="bold")
        figure.text(0.5, 0.935, fill(title, 70), ha="center", va="top", fontsize=7.5)
        _legend(figure, rows)
    return figure


def overview_figures(rows: Sequence[InfluenceRow], titles: Mapping[str, str]) -> list[Figure]:
    """Returns sheets with a panel per scenario. `titles`: by scenario; missing titles stay empty."""
    scenarios = list(by_scenario(rows).items())
    starts = range(0, len(scenarios), PANELS_PER_SHEET)
    return [_sheet(scenarios[start : start + PANELS_PER_SHEET], titles) for start in starts]


def _sheet(scenarios: Sequence[tuple[str, Sequence[InfluenceRow]]], titles: Mapping[str, str]) -> Figure:
    columns = min(3, len(scenarios))
    lines = math.ceil(len(scenarios) / columns)
    width, height = 2.5 * columns, 2.85 * lines + 0.4
    with style():
        figure = Figure(figsize=(max(width, 4.2), height))
        for number, (scenario, rows) in enumerate(scenarios):
            line, column = divmod(number, columns)
            left, bottom = column / columns, (0.35 + 2.85 * (lines - 1 - line)) / height
            axes = figure.add_axes((left + 0.02 / columns, bottom, 0.96 / columns, 2.4 / height))
            _spider(axes, rows, with_bounds=False)
            middle, top = left + 0.5 / columns, bottom + 2.82 / height
            figure.text(middle, top, scenario, ha="center", va="top", fontsize=10, fontweight="bold")
            name = fill(titles.get(scenario, ""), 44)
            figure.text(middle, top - 0.18 / height, name, ha="center", va="top", fontsize=6.5, linespacing=1.15)
        _legend(figure, [row for _, rows in scenarios for row in rows])
    return figure


def _spider(axes: Axes, rows: Sequence[InfluenceRow], *, with_bounds: bool) -> None:
    axes.set_axis_off()
    axes.set_aspect("equal")
    reach = 1.45 if with_bounds else 1.24
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)
    for quarter in range(5):
        radius = HUB + (1 - HUB) * quarter / 4
        axes.add_patch(Circle((0, 0), radius, fill=False, edgecolor=RULE, linewidth=0.7 if quarter in {0, 4} else 0.4))
    half = min(0.06, 0.8 * math.pi * HUB / len(rows))
    size = 8.0 if len(rows) <= 16 else max(3.0, 128 / len(rows))
    for number, row in enumerate(rows):
        angle = math.pi / 2 - 2 * math.pi * number / len(rows)
        name = f"{row.scenario}.{row.parameter}"
        bar = Polygon(_bar(angle, 0, 1, half), closed=True, facecolor="white", edgecolor=INK, linewidth=0.5, zorder=2)
        bar.set_gid(f"{name}.range")
        axes.add_patch(bar)
        ends = segment(row)
        if ends is not None:
            part = Polygon(_bar(angle, *_visible(*ends), half), closed=True, edgecolor=INK, linewidth=0.5, zorder=3)
            part.set_facecolor("white" if row.unknown else INFLUENTIAL)
            part.set_hatch(UNKNOWN if row.unknown else "")
            part.set_gid(f"{name}.{'unknown' if row.unknown else 'influential'}")
            axes.add_patch(part)
        _label(axes, row, angle, size, with_bounds=with_bounds)


def _label(axes: Axes, row: InfluenceRow, angle: float, size: float, *, with_bounds: bool) -> None:
    x, y = math.cos(angle), math.sin(angle)
    if not with_bounds or row.space_lower is None or row.space_upper is None:
        axes.text(1.12 * x, 1.12 * y, row.parameter, ha="center", va="center", fontsize=size)
        return
    below = [f"{_text(row.space_lower)} … {_text(row.space_upper)}{unit_text(row.unit)}"]
    if row.influential and (row.lower, row.upper) != (row.space_lower, row.space_upper):
        below.append(f"influential {_text(row.lower)} … {_text(row.upper)}")
    side = "left" if x > 0.15 else "right" if x < -0.15 else "center"
    far = 1.06 if side != "center" else 1.1
    x, y = far * x, far * y + 0.03 * len(below) + 0.06 * y
    axes.text(x, y, row.parameter, ha=side, va="center", fontsize=size, fontweight="bold")
    axes.text(x, y - 0.05, "\n".join(below), ha=side, va="top", fontsize=size - 1.5, linespacing=1.2)


def _text(value: float | None) -> str:
    return "" if value is None else f"{value:g}".replace("-", "\N{MINUS SIGN}")


def _visible(lower: float, upper: float) -> tuple[float, float]:
    """Returns a region that is wide enough to be seen."""
    missing = max(0.0, 0.012 - (upper - lower)) / 2
    return max(0.0, lower - missing), min(1.0, upper + missing)


def _bar(angle: float, start: float, end: float, half: float) -> list[tuple[float, float]]:
    """Returns the corners of a bar along an axis, from `start` to `end` of its range, 2 `half` wide."""
    x, y = math.cos(angle), math.sin(angle)
    inner, outer = (HUB + (1 - HUB) * share for share in (start, end))
    return [(radius * x - side * y, radius * y + side * x) for radius, side in
            ((inner, -half), (outer, -half), (outer, half), (inner, half))]  # fmt: skip


def _legend(figure: Figure, rows: Sequence[InfluenceRow]) -> None:
    handles = [
        Patch(facecolor=INFLUENTIAL, edgecolor=INK, linewidth=0.5, label="influential"),
        Patch(facecolor="white", edgecolor=INK, linewidth=0.5, label="not influential"),
    ]
    if any(row.unknown for row in rows):
        handles.append(
            Patch(facecolor="white", edgecolor=INK, linewidth=0.5, hatch=UNKNOWN, label="unknown, counts as influential")
        )
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), handlelength=1.6, columnspacing=1.6)

"""Figure 9: influential ranges, one spider plot per scenario, in the notation of the paper's Figures 5 and 9."""

import math
from collections.abc import Mapping, Sequence
from textwrap import fill

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch, Polygon

from drivecal.contracts.tables import InfluenceRow
from drivecal.report.figures.drawing import INFLUENTIAL, INK, RULE, sheets, style
from drivecal.report.sections import by_scenario, segment

HUB = 0.2
"""Radius at which the axes begin, of the rim's: at 0 they would cover each other."""
UNKNOWN = "//////"
"""Hatching of parameters that count as influential because nothing is known about them."""


def overview_figures(rows: Sequence[InfluenceRow], titles: Mapping[str, str]) -> list[Figure]:
    """Returns sheets with a panel per scenario, and its title if it has one in `titles`."""
    return [_sheet(scenarios, titles) for scenarios in sheets(list(by_scenario(rows).items()))]


def _sheet(scenarios: Sequence[tuple[str, Sequence[InfluenceRow]]], titles: Mapping[str, str]) -> Figure:
    columns = min(3, len(scenarios))
    lines = math.ceil(len(scenarios) / columns)
    with style():
        figure = Figure(figsize=(max(2.5 * columns, 4.2), 2.85 * lines + 0.4), layout="constrained")
        panels = figure.subplots(lines, columns, squeeze=False).flat
        for axes, (scenario, rows) in zip(panels, scenarios, strict=False):
            _spider(axes, rows)
            axes.set_title(scenario, fontsize=10, fontweight="bold")
            axes.text(0, -1.26, fill(titles.get(scenario, ""), 44), ha="center", va="top", fontsize=6.5, linespacing=1.15)
        for axes in list(panels)[len(scenarios) :]:
            axes.set_axis_off()
        _legend(figure, [row for _, rows in scenarios for row in rows])
    return figure


def _spider(axes: Axes, rows: Sequence[InfluenceRow]) -> None:
    axes.set_axis_off()
    axes.set_aspect("equal")
    axes.set(xlim=(-1.24, 1.24), ylim=(-1.24, 1.24), xticks=[], yticks=[])
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
        axes.text(1.12 * math.cos(angle), 1.12 * math.sin(angle), row.parameter, ha="center", va="center", fontsize=size)


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
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), handlelength=1.6, columnspacing=1.6)

"""The front of a campaign with objectives: two objectives at a time, and its hypervolume over the iterations."""

from collections.abc import Collection, Sequence
from itertools import combinations

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drivecal.contracts.results import FrontObjective, FrontSummary
from drivecal.contracts.tables import FrontRow
from drivecal.domain.scales import unit_text
from drivecal.report.figures.drawing import BLUE, INK, ORANGE, VERMILION, Drawn, style, whole_numbers

MOST_PAIRS = 3
"""Pairs of objectives that are drawn: all of three; of more, those with the first come first."""


def drawn(rows: Sequence[FrontRow], summary: FrontSummary, chosen: Collection[int] = ()) -> Drawn:
    """Returns the figure of a front with at least one set and two objectives; ranks that were `chosen` have a circle."""
    caption = (
        "Each point is a set that no other set dominates. Star: the knee, which gives the most for what it costs; diamonds: the "
        "best set of each objective; cross: the baseline. Last panel: the hypervolume of all sets by iteration."
    )
    return Drawn("figure-front", caption, front_figure(rows, summary, chosen))


def front_figure(rows: Sequence[FrontRow], summary: FrontSummary, chosen: Collection[int] = ()) -> Figure:
    """Draws a panel for each pair of objectives, and one of the hypervolume if it is known."""
    pairs = list(combinations(summary.objectives, 2))[:MOST_PAIRS]
    growth = [(step.iteration + 1, step.hypervolume) for step in summary.growth if step.hypervolume is not None]
    with style():
        panels = len(pairs) + bool(growth)
        columns = min(2, panels)
        lines = -(-panels // columns)
        figure = Figure(figsize=(7.4, 3.0 * lines), layout="constrained")
        places = list(figure.subplots(lines, columns, squeeze=False).flat)
        for (first, second), axes in zip(pairs, places, strict=False):
            _pair(axes, rows, summary, (first, second), chosen)
        if growth:
            axes = places[len(pairs)]
            (line,) = axes.plot(*zip(*growth, strict=True), color=BLUE, linewidth=1.4, drawstyle="steps-post")
            line.set_gid("front.hypervolume")
            axes.set(xlabel="iteration (0: sets of earlier campaigns)", ylabel="hypervolume", title="All sets so far")
            whole_numbers(axes)
        for axes in places[panels:]:
            axes.set_axis_off()
    return figure


def _pair(
    axes: Axes,
    rows: Sequence[FrontRow],
    summary: FrontSummary,
    pair: tuple[FrontObjective, FrontObjective],
    chosen: Collection[int],
) -> None:
    first, second = pair

    def place(objectives: dict[str, float]) -> tuple[float, float]:
        return objectives[first.name], objectives[second.name]

    name = f"front.{first.name}.{second.name}"
    (points,) = axes.plot(*zip(*(place(row.objectives) for row in rows), strict=True), "o", color=BLUE, markersize=4)
    points.set_gid(name)
    for row in rows:
        if row.rank in chosen:
            axes.plot(*place(row.objectives), "o", markerfacecolor="none", markeredgecolor=VERMILION, markersize=12)
        if row.knee:
            axes.plot(*place(row.objectives), "*", color=VERMILION, markersize=11)
        if first.name in row.best_in or second.name in row.best_in:
            axes.plot(*place(row.objectives), "D", markerfacecolor="none", markeredgecolor=ORANGE, markersize=8)
    if summary.baseline is not None:
        axes.plot(*place(summary.baseline.objectives), "x", color=INK, markersize=6)
    axes.set(xlabel=_label(first), ylabel=_label(second), title=f"{second.name} over {first.name}")
    axes.margins(0.08)


def _label(objective: FrontObjective) -> str:
    return f"{objective.name}{unit_text(objective.unit, ' / ')} ({'more' if objective.direction == 'maximise' else 'less'} is better)"

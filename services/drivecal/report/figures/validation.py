"""Figure 14 of the paper: the histogram of deviations."""

import math
from collections.abc import Iterator, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator, NullFormatter, StrMethodFormatter

from drivecal.contracts.tables import ValidationRow
from drivecal.domain.scales import COMFORT, Scale, unit_text
from drivecal.report.figures.drawing import BLUE, INK, VERMILION, Drawn, style
from drivecal.report.sections import histogram_bins

PANELS_PER_SHEET = 12


def drawn(rows: Sequence[ValidationRow], scale: Scale = COMFORT) -> Iterator[Drawn]:
    """Yields the sheets of Figure 14; none if nothing was compared."""
    compared = [row for row in rows if row.compared]
    caption = (
        "How far the scores of variants, which differ from a basis only where the map says that it does not matter, are from "
        "the score of the basis; on a logarithmic scale, or all but the zeros would be invisible. Hatched: by more than "
        f"{scale.amount(scale.tolerance)}, wrong."
    )
    for number, start in enumerate(range(0, len(compared), PANELS_PER_SHEET), 1):
        sheet = compared[start : start + PANELS_PER_SHEET]
        alt = "; ".join(
            f"{row.scenario}: {row.compared - row.different:,} of {row.compared:,} unchanged, {row.wrong:,} wrong"
            for row in sheet
        )
        name = "figure-14-validation" if number == 1 else f"figure-14-validation-{number}"
        yield Drawn(name, caption, validation_figure(sheet, scale), alt=f"Histograms of deviations. {alt}.")


def validation_figure(rows: Sequence[ValidationRow], scale: Scale = COMFORT) -> Figure:
    """Draws a histogram per scenario of the differences between variants and their bases, in units of the score."""
    bins = histogram_bins(rows, scale)
    last, width = bins[-1] * rows[0].histogram_step, rows[0].histogram_step
    columns = min(3, len(rows))
    lines = math.ceil(len(rows) / columns)
    top = max(max(row.histogram.values(), default=1) for row in rows)
    with style():
        figure = Figure(figsize=(max(3.6, 2.47 * columns), 0.5 + 1.75 * lines), layout="constrained")
        panels = figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True)
        for place, axes in enumerate(panels.flat):
            if place >= len(rows):
                axes.set_axis_off()
                continue
            _panel(axes, rows[place], scale)
            axes.set(yscale="log", ylim=(0.7, 2.5 * top), xlim=(-last - 0.6 * width, last + 0.6 * width))
            axes.xaxis.set_major_locator(MaxNLocator(8, integer=scale.is_whole, symmetric=True))
            axes.yaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
            axes.yaxis.set_minor_formatter(NullFormatter())
            axes.grid(visible=False, axis="x")
        figure.supxlabel(f"difference from the basis{unit_text(scale.unit, ', ')}", fontsize=8)
        figure.supylabel("variants", fontsize=8)
        handles = [
            Patch(facecolor=BLUE, edgecolor=INK, linewidth=0.4, label=f"up to {scale.amount(scale.tolerance)}"),
            Patch(facecolor=VERMILION, edgecolor="white", hatch="////", linewidth=0.4, label="wrong"),
        ]
        figure.legend(handles=handles, loc="outside upper right", ncols=2)  # below it would lie on the label
    return figure


def _panel(axes: Axes, row: ValidationRow, scale: Scale) -> None:
    for number, count in row.histogram.items():
        if not count:
            continue
        difference = number * row.histogram_step
        wrong = scale.is_wrong(difference)
        colour, hatch = (VERMILION, "////") if wrong else (BLUE, None)
        (bar,) = axes.bar(difference, count, width=0.85 * row.histogram_step, color=colour, hatch=hatch)
        bar.set(edgecolor="white" if wrong else INK, linewidth=0.4, gid=f"{row.scenario}.{number}")
    rate = "" if row.error_rate is None else f": {row.different / row.compared:.1%} differ, R_err {row.error_rate:.2%}"
    axes.set_title(f"{row.scenario}{rate}")

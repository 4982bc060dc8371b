"""Figures 12 (right) and 14: robustness of the best sets against other vehicles, and the deviations of a validation."""

import math
from collections.abc import Iterator, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import MaxNLocator, NullFormatter, StrMethodFormatter

from drivecal.contracts.results import StudyResult
from drivecal.contracts.tables import BoxTrial, RobustnessRow, ValidationRow
from drivecal.domain.scales import COMFORT, Scale, unit_text
from drivecal.report.figures.drawing import BLUE, INK, SKY, VERMILION, Drawn, sheets, style
from drivecal.report.robustness import condition
from drivecal.report.sections import histogram_bins

MOST_DRAWN = 40
"""Sets that are drawn; all of them are in the table."""
UNCHANGED, CHANGED = "#F2F2F2", SKY
NARROW = 0.035
"""Boxes that are narrower than this share of the figure have no room for a number."""


def robustness(studies: Sequence[StudyResult]) -> Iterator[Drawn]:
    """Yields Figure 12, right, of each study."""
    for number, studied in enumerate(studies, 1):
        yield _drawn(studied, "figure-12-robustness" if number == 1 else f"figure-12-robustness-{number}")


def _drawn(studied: StudyResult, name: str) -> Drawn:
    some = (
        f"the first {MOST_DRAWN} of {len(studied.robustness)} examined sets"
        if len(studied.robustness) > MOST_DRAWN
        else "each examined set"
    )
    model = f"; vehicle model: {studied.study.vehicle}" if studied.study.vehicle else ""
    caption = (
        f"For {some} (the most robust on top) the largest deviation, over all scenarios and vehicles, in growing boxes "
        f"around the nominal vehicle, the first of half width {studied.study.settings['delta']:g}; condition: "
        f"{condition(studied.study.settings)}{model}. The heavy line is the widest box that holds."
    )
    if any(row.recommended for row in studied.robustness[:MOST_DRAWN]):
        caption += " A star marks the recommended set."
    return Drawn(name, caption, robustness_figure(studied.robustness[:MOST_DRAWN]))


def robustness_figure(rows: Sequence[RobustnessRow]) -> Figure:
    """Draws a bar per set from 0 to the widest tried box. Each piece, from one box to the next, shows the largest deviation in it."""
    widest = max((trial.radius for row in rows for trial in row.trials), default=1.0)
    with style():
        figure = Figure(figsize=(7.4, 1.1 + 0.24 * len(rows)), layout="constrained")
        axes = figure.subplots()
        axes.grid(visible=False)
        for place, row in enumerate(rows):
            start = 0.0
            for trial in sorted(row.trials, key=lambda trial: trial.radius):
                worst = _worst(trial)
                piece = Rectangle((start, place - 0.4), trial.radius - start, 0.8, edgecolor="white", linewidth=0.6)
                piece.set(
                    facecolor=VERMILION if not trial.holds else CHANGED if worst else UNCHANGED,
                    gid=f"box.{row.rank}.{trial.box}",
                )
                if not trial.holds:
                    piece.set(hatch="////", edgecolor="white")
                axes.add_patch(piece)
                if trial.radius - start > NARROW * widest:
                    text = "–" if worst is None else f"{worst:.2g}"
                    box = {"facecolor": "white", "edgecolor": "none", "pad": 0.8} if not trial.holds else None
                    axes.text((start + trial.radius) / 2, place, text, ha="center", va="center", fontsize=6.5, bbox=box)
                start = trial.radius
            axes.plot([row.radius] * 2, [place - 0.46, place + 0.46], color=INK, linewidth=2.2, solid_capstyle="butt")
        axes.set_yticks(range(len(rows)), [f"{row.rank}{' *' if row.recommended else ''}" for row in rows])
        axes.set(xlim=(0, widest * 1.01), ylim=(len(rows) - 0.45, -0.55))
        axes.set(xlabel="half width of the box, in shares of the vehicle parameters' ranges", ylabel="rank")
        handles = [
            Patch(facecolor=UNCHANGED, edgecolor=INK, linewidth=0.4, label="holds, no score changes"),
            Patch(facecolor=CHANGED, edgecolor=INK, linewidth=0.4, label="holds"),
            Patch(facecolor=VERMILION, edgecolor="white", hatch="////", linewidth=0.4, label="does not hold"),
        ]
        figure.legend(handles=handles, loc="outside lower left", ncols=3)
    return figure


def _worst(trial: BoxTrial) -> float | None:
    known = [away for away in trial.deviations.values() if away is not None]
    return max(known) if len(known) == len(trial.deviations) else None


def validation(rows: Sequence[ValidationRow], scale: Scale = COMFORT) -> Iterator[Drawn]:
    """Yields the sheets of Figure 14; none if nothing was compared."""
    compared = [row for row in rows if row.compared]
    caption = (
        "How far the scores of variants, which differ from a basis only where the map says that it does not matter, are from "
        "the score of the basis; on a logarithmic scale, or all but the zeros would be invisible. Hatched: by more than "
        f"{scale.amount(scale.tolerance)}, wrong."
    )
    for number, sheet in enumerate(sheets(compared), 1):
        name = "figure-14-validation" if number == 1 else f"figure-14-validation-{number}"
        yield Drawn(name, caption, validation_figure(sheet, scale))


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

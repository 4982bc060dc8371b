"""Figure 12, right: robustness of the best sets against other vehicles."""

from collections.abc import Iterator, Sequence

from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from drivecal.contracts.results import StudyResult
from drivecal.contracts.tables import BoxTrial, RobustnessRow
from drivecal.report.figures.drawing import INK, SKY, VERMILION, Drawn, style
from drivecal.report.robustness import condition, degree

MOST_DRAWN = 40
"""Sets that are drawn; all of them are in the table."""
UNCHANGED, CHANGED = "#F2F2F2", SKY
NARROW = 0.035
"""Boxes that are narrower than this share of the figure have no room for a number."""


def drawn(studies: Sequence[StudyResult]) -> Iterator[Drawn]:
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
    alt = "Bars by examined set. " + "; ".join(
        f"rank {row.rank}: degree {degree(row).replace('≥', 'at least')}, holds up to {row.radius:g}"
        for row in studied.robustness[:MOST_DRAWN]
    )
    return Drawn(name, caption, robustness_figure(studied.robustness[:MOST_DRAWN]), alt=f"{alt}.")


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

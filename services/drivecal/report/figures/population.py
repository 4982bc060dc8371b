"""Figure 10: the population's objectives and the number of alternative optima over the iterations."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from drivecal.contracts.tables import Generation
from drivecal.report.figures.drawing import BLUE, INK, ORANGE, VERMILION, Drawn, plotted, style, whole_numbers

LARGEST_WITH_MARKERS = 60
"""Iterations up to which each gets a marker."""
LINES = (("best", "best", BLUE, "-", "o"), ("mean", "mean", ORANGE, "--", "s"), ("minimum", "worst", VERMILION, ":", "v"))
"""Field, label, colour, dashes, marker: distinguishable without colours."""


def drawn(generations: Sequence[Generation], baseline: float | None = None) -> Drawn:
    """Returns Figure 10."""
    caption = (
        "Left: the objectives of the population in each iteration. Right: how many distinct parameter sets had been found "
        "by then with the best objective by then."
    )
    answered = [generation for generation in generations if generation.best is not None]
    alt = "Nothing is answered yet."
    if answered:
        first, last = answered[0], answered[-1]
        alt = (
            f"The best objective goes from {_text(first.best)} in iteration {first.iteration + 1} to {_text(last.best)} in iteration "
            f"{last.iteration + 1}, the mean from {_text(first.mean)} to {_text(last.mean)}; at the end {last.alternatives} parameter sets "
            "share the best objective."
        )
    return Drawn("figure-10-population", caption, population_figure(generations, baseline), alt=alt)


def population_figure(generations: Sequence[Generation], baseline: float | None = None) -> Figure:
    """Draws best, mean and worst of each population with the `baseline`, and the number of alternative optima so far."""
    numbers = [generation.iteration + 1 for generation in generations]
    marked = len(numbers) <= LARGEST_WITH_MARKERS
    with style():
        figure = Figure(figsize=(7.4, 3.0), layout="constrained")
        left, right = figure.subplots(1, 2)
        for field, label, colour, dashes, marker in LINES:
            values = [plotted(getattr(generation, field)) for generation in generations]
            (line,) = left.plot(numbers, values, linestyle=dashes, color=colour, label=label, linewidth=1.4)
            line.set_gid(f"population.{field}")
            if marked:
                line.set(marker=marker, markersize=3.5)
        if baseline is not None:
            line = left.axhline(baseline, color=INK, linewidth=0.8, linestyle=(0, (6, 3)), label="baseline")
            line.set_gid("population.baseline")
        left.set(xlabel="iteration", ylabel="objective", title="Population")
        left.margins(y=0.08)
        figure.legend(*left.get_legend_handles_labels(), loc="outside lower left", ncols=4)
        # An iteration that has no best yet is still being answered, and its alternatives are not counted.
        counts = [float("nan") if generation.best is None else generation.alternatives for generation in generations]
        (line,) = right.plot(numbers, counts, color=BLUE, linewidth=1.4, drawstyle="steps-mid")
        line.set_gid("population.alternatives")
        if marked:
            line.set(marker="o", markersize=3.5)
        best = next((generation.best for generation in reversed(generations) if generation.best is not None), None)
        title = "Sets with the best objective" if best is None else f"Sets with the best objective, {best:.3f}"
        right.set(xlabel="iteration", ylabel="number of parameter sets", title=title)
        right.set_ylim(0, max(1, *(generation.alternatives for generation in generations)) * 1.08)
        for axes in (left, right):
            whole_numbers(axes)
            axes.set_xlim(0.5, max(numbers) + 0.5)
        right.yaxis.get_major_locator().set_params(integer=True)
    return figure


def _text(value: float | None) -> str:
    return "nothing" if value is None else f"{value:.3f}"

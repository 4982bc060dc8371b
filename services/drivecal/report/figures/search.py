"""Figures 10 and 11: the population by iteration, and the accumulated cells by outcome."""

from collections.abc import Sequence
from itertools import accumulate

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from drivecal.contracts.tables import Generation
from drivecal.report.figures.drawing import BLUE, INK, ORANGE, PURPLE, SKY, VERMILION, Drawn, plotted, style, whole_numbers

LARGEST_WITH_MARKERS = 60
"""Iterations up to which each gets a marker."""
LINES = (("best", "best", BLUE, "-", "o"), ("mean", "mean", ORANGE, "--", "s"), ("minimum", "worst", VERMILION, ":", "v"))
"""Field, label, colour, dashes, marker: distinguishable without colours."""


def population(generations: Sequence[Generation], baseline: float | None = None) -> Drawn:
    """Returns Figure 10."""
    caption = (
        "Left: the objectives of the population in each iteration. Right: how many distinct parameter sets had been found "
        "by then with the best objective by then."
    )
    answered = [generation for generation in generations if generation.best is not None]
    if answered:
        first, last = answered[0], answered[-1]
        caption += (
            f" The best objective goes from {first.best:.3f} in iteration {first.iteration + 1} to {last.best:.3f} in iteration "
            f"{last.iteration + 1}; {last.alternatives} parameter sets share it."
        )
    return Drawn("figure-10-population", caption, population_figure(generations, baseline))


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


OUTCOMES = (
    ("simulated", "simulated", "#D9D9D9", ""),
    ("audited", "simulated as an audit", "#B0B0B0", "\\\\\\\\"),
    ("failed", "failed", VERMILION, "xxxx"),
    ("predicted", "predicted", PURPLE, "++++"),
    ("repeated", "repeated", SKY, ""),
    ("reused", "answered by a reference", BLUE, "////"),
)
"""Field, label, colour and hatching, from the bottom: what was simulated below, what was saved above."""


def accumulated(generations: Sequence[Generation]) -> dict[str, list[int]]:
    """Returns the cells of all iterations up to each, by outcome (fields of OUTCOMES)."""
    return {field: list(accumulate(_count(generation, field) for generation in generations)) for field, *_ in OUTCOMES}


def cells(generations: Sequence[Generation]) -> Drawn:
    """Returns Figure 11."""
    caption = (
        "Requested cells, one parameter set in one scenario each, added up over the iterations by what answered them. What "
        "the optimizer carried over unchanged is not requested; the runs of the sensitivity analysis are not in it."
    )
    return Drawn("figure-11-cells", caption, cells_figure(generations))


def cells_figure(generations: Sequence[Generation]) -> Figure:
    """Draws the requested cells of all iterations up to each, stacked by outcome, without outcomes that never occurred."""
    totals = accumulated(generations)
    numbers = [generation.iteration + 1 for generation in generations]
    edges = np.append(np.array(numbers) - 0.5, numbers[-1] + 0.5)
    requested = sum(values[-1] for values in totals.values())
    saved = sum(totals[field][-1] for field in ("repeated", "reused", "predicted")) / max(1, requested)
    with style():
        figure = Figure(figsize=(7.4, 3.6), layout="constrained")
        axes = figure.subplots()
        base = np.zeros(len(numbers))
        for field, label, colour, hatch in OUTCOMES:
            values = totals[field]
            if not values[-1]:
                continue
            share = f"{label}: {values[-1]:,} ({values[-1] / requested:.1%})"
            part = axes.stairs(base + values, edges, baseline=base, fill=True, facecolor=colour, label=share)
            part.set(hatch=hatch or None, edgecolor="white", linewidth=0.0)
            part.set_gid(f"cells.{field}")
            axes.stairs(base + values, edges, baseline=None, color="#222222", linewidth=0.5)
            base += values
        whole_numbers(axes)
        axes.set(xlabel="iteration", ylabel="accumulated cells", xlim=(edges[0], edges[-1]))
        axes.set_title(f"{requested:,} requested cells, {saved:.1%} answered without a simulation")
        axes.set_ylim(0, max(1.0, float(base[-1])) * 1.05)
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
        handles, labels = axes.get_legend_handles_labels()
        figure.legend(handles[::-1], labels[::-1], loc="outside right center")
    return figure


def _count(generation: Generation, field: str) -> int:
    """Returns a count without audited cells among the simulated ones."""
    count: int = getattr(generation, field)
    return count - generation.audited if field == "simulated" else count

"""Figure 11: the accumulated cells by outcome."""

from collections.abc import Sequence
from itertools import accumulate

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from drivecal.contracts.tables import Generation
from drivecal.report.figures.drawing import BLUE, PURPLE, SKY, VERMILION, Drawn, style, whole_numbers

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


def drawn(generations: Sequence[Generation]) -> Drawn:
    """Returns Figure 11."""
    caption = (
        "Requested cells, one parameter set in one scenario each, added up over the iterations by what answered them. What "
        "the optimizer carried over unchanged is not requested; the runs of the sensitivity analysis are not in it."
    )
    totals = accumulated(generations)
    parts = ", ".join(f"{totals[field][-1]:,} {label}" for field, label, *_ in OUTCOMES)
    alt = f"Stacked areas that end at {sum(total[-1] for total in totals.values()):,} requested cells: {parts}."
    return Drawn("figure-11-cells", caption, cells_figure(generations), alt=alt)


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

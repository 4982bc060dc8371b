"""The figures of a comparison: the runs of each optimizer (Figures 7 and 8), final optima, and effects of a reduction."""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import accumulate, chain, count
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from drivecal.contracts.comparison import ComparedPair, ComparedRun, ReductionEffect
from drivecal.contracts.tables import Generation
from drivecal.report.figures.drawing import BLUE, INK, KINDS, RULE, Dashes, Drawn, plotted, style, whole_numbers

MARKERS = "osv^DPX*"
SPREAD = 0.06
"""Spread of lines of equal value, which would hide each other, in shares of the drawn range."""
Kind = tuple[int, str]
"""Population and reduction of a run."""


def search_figures(
    runs: Sequence[ComparedRun], generations: Mapping[str, Sequence[Generation]], sign: int = 1
) -> Iterator[Drawn]:
    """Yields one figure per optimizer, with a line per run: the best objective over iterations and over simulations.

    If all runs always have the same best objective, the latter shows the rating of the best set. `sign`: -1 if lower
    objectives are better.
    """
    kinds = list(dict.fromkeys((run.population, run.reduction) for run in runs))
    values = [entry.best for listed in generations.values() for entry in listed if entry.best is not None]
    if not values:
        return
    low, high = min(values), max(values)
    margin = 0.1 * (high - low) or 0.5
    names: set[str] = set()
    for optimizer in dict.fromkeys(run.optimizer for run in runs):
        mine = [run for run in runs if run.optimizer == optimizer and generations.get(run.run)]
        if mine:
            with style():
                figure = Figure(figsize=(7.4, 3.2), layout="constrained")
                left, right = figure.subplots(1, 2)
                _draw_runs(left, right, mine, generations, kinds, SPREAD * (high - low + 2 * margin), by_rating=low == high)
                for axes in (left, right) if low < high else (left,):
                    axes.set_ylim(low - margin, high + margin)
                _label(figure, left, right, optimizer, kinds, by_rating=low == high)
            best = max((run.best for run in mine if run.best is not None), key=lambda value: sign * value, default=None)
            best_text = "nothing is answered yet" if best is None else f"the best objective found is {best:.3f}"
            name = _unlike(f"search-{_slug(optimizer)}", names)
            names.add(name)
            alt = f"{len(mine)} runs of {optimizer}; {best_text}."
            yield Drawn(name, _caption(optimizer, by_rating=low == high), figure, alt=alt)


def _draw_runs(
    left: Axes,
    right: Axes,
    runs: Sequence[ComparedRun],
    generations: Mapping[str, Sequence[Generation]],
    kinds: Sequence[Kind],
    spread: float,
    *,
    by_rating: bool,
) -> None:
    for place, run in enumerate(runs):
        listed = generations[run.run]
        colour, dashes = _look(kinds, (run.population, run.reduction))
        look: dict[str, Any] = {"color": colour, "linestyle": dashes, "linewidth": 1.0}
        offset = spread * ((place + 0.5) / len(runs) - 0.5)
        heights = [plotted(generation.best) + offset for generation in listed]
        left.plot([generation.iteration + 1 for generation in listed], heights, drawstyle="steps-mid", **look)
        if run.converged_at is not None:
            left.plot(run.converged_at, heights[run.converged_at - 1], marker="o", markersize=3, color=colour)
        taken = list(accumulate(map(_simulations, listed)))
        ratings = [plotted(generation.rating) for generation in listed]
        right.plot(taken, ratings if by_rating else heights, drawstyle="steps-post", **look)


def _simulations(generation: Generation) -> int:
    """Requested cells that neither copies nor predictions answered."""
    return generation.requested - generation.repeated - generation.reused - generation.predicted


def _label(figure: Figure, left: Axes, right: Axes, optimizer: str, kinds: Sequence[Kind], *, by_rating: bool) -> None:
    left.set(xlabel="iteration", ylabel="best objective")
    right.set(xlabel="simulations", ylabel="rating of the best set" if by_rating else "best objective")
    whole_numbers(left)
    several = len({reduction for _, reduction in kinds}) > 1
    names = [f"{population:,}, {reduction}" if several else f"{population:,}" for population, reduction in kinds]
    lines = [Line2D([], [], color=_look(kinds, kind)[0], linestyle=_look(kinds, kind)[1]) for kind in kinds]
    title = f"{optimizer}: individuals per iteration{', reduction' if several else ''}"
    figure.legend(lines, names, loc="outside lower center", ncols=4, title=title)


def _caption(optimizer: str, *, by_rating: bool) -> str:
    over = (
        "Right: since all runs have the same best objective, the weighted continuous rating of the best set, over the simulations that the "
        "run took."
        if by_rating
        else "Right: the same over the simulations that the run took."
    )
    return (
        f"All runs of {optimizer}. Left: the best objective by iteration; lines of equal value are drawn beside "
        f"each other, a dot marks where a run had converged. {over}"
    )


def optima_figure(runs: Sequence[ComparedRun]) -> Drawn:
    """Returns a figure of the final objective and cost of each run, by population."""
    populations = list(dict.fromkeys(run.population for run in runs))
    kinds = list(dict.fromkeys((run.optimizer, run.reduction) for run in runs))
    several = len({reduction for _, reduction in kinds}) > 1
    with style():
        figure = Figure(figsize=(7.4, 2.9), layout="constrained")
        panels = figure.subplots(1, 3)
        for number, kind in enumerate(kinds):
            mine = [run for run in runs if (run.optimizer, run.reduction) == kind and run.best is not None]
            across = []
            for run in mine:
                peers = [other for other in mine if other.population == run.population]
                within = (peers.index(run) - (len(peers) - 1) / 2) / max(len(peers), 1)
                slot = (number - (len(kinds) - 1) / 2) + 0.7 * within
                across.append(populations.index(run.population) + 0.8 * slot / len(kinds))
            look = {"linestyle": "none", "marker": MARKERS[number % len(MARKERS)], "markersize": 3.5}
            label = ", ".join(kind) if several else kind[0]
            colour = KINDS[number % len(KINDS)][0]
            for axes, field in zip(panels, ("simulated_best", "rating", "simulations"), strict=True):
                axes.plot(across, [plotted(getattr(run, field)) for run in mine], color=colour, label=label, **look)
        for axes, what in zip(panels, ("best objective", "rating of the best set", "simulations"), strict=True):
            axes.set_xticks(range(len(populations)), [f"{population:,}" for population in populations])
            axes.set(xlabel="individuals per iteration", ylabel=what, xlim=(-0.6, len(populations) - 0.4))
        panels[-1].set_ylim(0, 1.08 * max(run.simulations for run in runs))
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    caption = (
        "Final optima of all runs with the ratings of their best sets, and the simulations that each took; one mark per seed."
    )
    return Drawn("optima", caption, figure, alt=f"{len(runs)} runs of {len(kinds)} kinds by population size.")


def effects_figure(pairs: Sequence[ComparedPair], effects: Sequence[ReductionEffect]) -> Drawn:
    """Draws the differences of the final optima of all pairs with their mean and interval, and the shares of saved simulations."""
    named = [effect for effect in effects if effect.optimizer is not None]
    with style():
        figure = Figure(figsize=(7.4, 1.4 + 0.5 * len(named)), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        for row, effect in enumerate(named):
            kind = (effect.optimizer, effect.population, effect.reduction)
            mine = [pair for pair in pairs if (pair.optimizer, pair.population, pair.reduction) == kind]
            heights = [row + 0.5 * ((place + 0.5) / len(mine) - 0.5) for place in range(len(mine))]
            left.plot([run.difference for run in mine], heights, linestyle="none", marker="o", markersize=3, color=BLUE)
            if effect.lower_95 is not None and effect.upper_95 is not None:
                left.plot([effect.lower_95, effect.upper_95], [row - 0.36] * 2, color=INK, linewidth=1.2)
            left.plot(effect.mean_difference, row - 0.36, marker="D", markersize=4, color=INK)
            shares = [100 * run.saved / run.base_simulations if run.base_simulations else 0.0 for run in mine]
            right.plot(shares, heights, linestyle="none", marker="o", markersize=3, color=BLUE)
        left.axvline(0, color=RULE, linewidth=0.8, zorder=0)
        names = [f"{name.optimizer}, {name.population:,}\n{name.reduction}" for name in named]
        left.set_yticks(range(len(named)), names)
        left.set(xlabel="difference of the final optimum", ylim=(len(named) - 0.5, -0.6))
        right.set(xlabel="simulations saved, %")
    caption = (
        "Each dot is a pair of searches with the same seed: with the reduction less without it. Diamond and line: the mean with its 95 % "
        "confidence interval."
    )
    equal, every = sum(name.equal for name in named), sum(name.pairs for name in named)
    return Drawn("reduction", caption, figure, alt=f"{equal} of {every} pairs end with equal optima.")


def _look(kinds: Sequence[Kind], kind: Kind) -> tuple[str, Dashes]:
    return KINDS[kinds.index(kind) % len(KINDS)]


def _unlike(name: str, others: Collection[str]) -> str:
    """Returns a unique name: different labels may give equal names of files."""
    numbered = (f"{name}-{number}" for number in count(2))
    return next(candidate for candidate in chain([name], numbered) if candidate not in others)


def _slug(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-") or "optimizer"

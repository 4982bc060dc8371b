"""Figure 12, left: the sets that share the best objective in parallel coordinates."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from drivecal.contracts.setup import SearchedParameter
from drivecal.contracts.tables import OptimumRow, Solution
from drivecal.domain.scales import unit_text
from drivecal.plugins.ports import Floats
from drivecal.report.blocks import counted
from drivecal.report.figures.drawing import INK, KINDS, RULE, Drawn, style
from drivecal.report.sections import searched

MOST_BEST, MOST_OTHERS = 200, 200
"""Lines that are drawn of the best sets and of the sets that rank next."""
OTHER_REGIONS = "#555555"
WORSE = "#D0D0D0"


def positions(sets: Sequence[Solution], parameters: Sequence[SearchedParameter]) -> Floats:
    """Returns the values as shares of the parameters' ranges, shape (n_sets, n_parameters)."""
    rows = [_shares(parameter_set.parameters, parameters) for parameter_set in sets]
    return np.array(rows, dtype=np.float64).reshape(len(sets), len(parameters))


def _shares(values: Mapping[str, float | str], parameters: Sequence[SearchedParameter]) -> list[float]:
    return [_share(values[each.name], each) for each in parameters]


def _share(value: float | str, parameter: SearchedParameter) -> float:
    """Returns the height of a value; choices are spread evenly, in the order of their list."""
    number = parameter.choices.index(value) if isinstance(value, str) else value
    return (number - parameter.lower) / (parameter.upper - parameter.lower)


def drawn(
    optima: Sequence[OptimumRow],
    solutions: Sequence[Solution],
    parameters: Sequence[SearchedParameter],
    recommended: Mapping[str, float | str] | None = None,
) -> Drawn:
    """Returns Figure 12, left.

    `solutions`: the best of the ranking, with `optima`. `recommended`: the values of the set that a robustness study recommends.
    """
    axes = searched(parameters)
    worse = [solution for solution in solutions if solution.rank > len(optima)][:MOST_OTHERS]
    shown = f"the first {MOST_BEST} of the {len(optima)} sets" if len(optima) > MOST_BEST else counted(len(optima), "set")
    caption = (
        f"{shown[0].upper()}{shown[1:]} with the best objective, each a line through its values, from the lower to the "
        f"upper bound of each searched parameter; lines of one kind lie in one region."
    )
    if worse:
        caption += f" Grey: the {len(worse)} sets that rank next."
    if recommended is not None:
        caption += " Black with dots: the set that the robustness study recommends."
    return Drawn("figure-12-optima", caption, optima_figure(optima[:MOST_BEST], worse, axes, recommended))


def optima_figure(
    best: Sequence[OptimumRow],
    worse: Sequence[Solution],
    parameters: Sequence[SearchedParameter],
    recommended: Mapping[str, float | str] | None = None,
) -> Figure:
    """Draws parallel coordinates over the searched `parameters`."""
    places = np.arange(len(parameters))
    with style():
        figure = Figure(figsize=(max(7.4, 0.55 * len(parameters)), 3.7), layout="constrained")
        axes = figure.subplots()
        axes.grid(visible=False)
        for spine in axes.spines.values():
            spine.set_visible(False)
        axes.vlines(places, 0, 1, color=RULE, linewidth=0.8, zorder=1)
        _lines(axes, positions(worse, parameters), WORSE, "-", 0.5, "optima.worse", 2)
        handles = _regions(axes, best, parameters)
        if recommended is not None:
            look: dict[str, Any] = {"color": INK, "linewidth": 1.0, "marker": "o", "markersize": 3.5, "zorder": 5.5}
            handles += axes.plot(places, _shares(recommended, parameters), label="recommended", gid="recommended", **look)
        if worse:
            handles.append(Line2D([], [], color=WORSE, linewidth=1.2, label="ranked next"))
        for place, parameter in enumerate(parameters):
            ends = (parameter.choices[-1], parameter.choices[0]) if parameter.choices else (parameter.upper, parameter.lower)
            for height, value, side in ((1.03, ends[0], "bottom"), (-0.03, ends[1], "top")):
                axes.text(place, height, _value(value), ha="center", va=side, fontsize=6.5, color="#555555")
        axes.set_xticks(places, [f"{parameter.name}\n{unit_text(parameter.unit, '')}" for parameter in parameters])
        axes.tick_params(axis="x", length=0, pad=11)
        axes.set_yticks([])
        axes.set(xlim=(-0.4, len(parameters) - 0.6), ylim=(-0.04, 1.04))
        figure.legend(handles=handles, loc="outside lower left", ncols=4, handlelength=3.2)
    return figure


def _regions(axes: Axes, best: Sequence[OptimumRow], parameters: Sequence[SearchedParameter]) -> list[Line2D]:
    """Draws the best sets, the first on top. Returns the legend's entries: one per region, and one for all further regions."""
    counts = Counter(min(solution.region, len(KINDS)) for solution in best)
    handles = []
    for region in sorted(counts):
        members = [solution for solution in best if min(solution.region, len(KINDS)) == region]
        if region < len(KINDS):
            (colour, dashes), label = KINDS[region], f"region {region}: {counted(len(members), 'set')}"
        else:
            others = len({member.region for member in members})
            colour, dashes, label = OTHER_REGIONS, "-", f"{counted(others, 'other region')}: {counted(len(members), 'set')}"
        width = 1.5 if region < len(KINDS) else 0.7
        _lines(axes, positions(members, parameters), colour, dashes, width, f"optima.{region}", 5 - 0.01 * region)
        handles.append(Line2D([], [], color=colour, linestyle=dashes, linewidth=width, label=label))
    return handles


def _lines(axes: Axes, heights: Floats, colour: str, dashes: object, width: float, gid: str, order: float) -> None:
    if not len(heights):
        return
    across = np.broadcast_to(np.arange(heights.shape[1], dtype=np.float64), heights.shape)
    lines = LineCollection(list(np.stack([across, heights], axis=2)), colors=colour, linestyles=dashes, linewidths=width)
    lines.set(zorder=order, gid=gid)
    axes.add_collection(lines)


def _value(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}".replace("-", "\N{MINUS SIGN}")

"""The front as a small drawing for each pair of objectives, without a plotting library: the API writes it."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

from markupsafe import Markup

from drivecal.contracts.results import FrontObjective
from drivecal.domain.scales import unit_text
from drivecal.report.markup import drawing, rendered

WIDTH, HEIGHT = 440, 270
LEFT, RIGHT, TOP, BOTTOM = 70, 425, 12, 220
MOST_DRAWN = 3
"""Objectives whose pairs are drawn."""
MOST_POINTS = 500
MARGIN = 0.06
"""Free share of an axis beyond the outermost points."""
NARROWEST = 1e-6
"""Least free share of the values themselves: narrower axes are noise."""
_STEPS = (1.0, 2.0, 5.0)

Point = Sequence[float]


def drawings(objectives: Sequence[FrontObjective], front: Sequence[Point], marked: Mapping[str, Point]) -> Iterator[str]:
    """Yields a figure for each pair of the first objectives. `front`: the values of its sets; `marked`: those of sets by their labels."""
    shown = front[:: math.ceil(len(front) / MOST_POINTS)] if front else front
    for first, second in combinations(range(min(len(objectives), MOST_DRAWN)), 2):
        pair = [objectives[first], objectives[second]]
        names = [f"{goal.name}{unit_text(goal.unit, ', ')} ({goal.direction})" for goal in pair]
        points = [(point[first], point[second]) for point in shown]
        labelled = {label: (point[first], point[second]) for label, point in marked.items()}
        some = f"{len(shown)} of {len(front):,}" if len(shown) < len(front) else f"{len(front):,}"
        yield drawing(_scatter(names, points, labelled), f"{some} sets of the front: {names[0]} and {names[1]}")


def _scatter(names: Sequence[str], points: Sequence[Point], marked: Mapping[str, Point]) -> Markup:
    every = [*points, *marked.values()]
    across, up = (_Axis([point[place] for point in every]) for place in (0, 1))

    def placed(point: Point) -> tuple[float, float]:
        x = LEFT + across.share(point[0]) * (RIGHT - LEFT)
        return round(x, 1), round(BOTTOM - up.share(point[1]) * (BOTTOM - TOP), 1)

    return rendered(
        "scatter.svg.jinja",
        width=WIDTH,
        height=HEIGHT,
        left=LEFT,
        right=RIGHT,
        top=TOP,
        bottom=BOTTOM,
        label=f"Scatter plot of {names[0]} and {names[1]}",
        names=names,
        across=[(round(LEFT + across.share(value) * (RIGHT - LEFT), 1), f"{value:g}") for value in across.ticks()],
        up=[(round(BOTTOM - up.share(value) * (BOTTOM - TOP), 1), f"{value:g}") for value in up.ticks()],
        points=[placed(point) for point in points],
        marked=[(*placed(point), label) for label, point in marked.items()],
    )


class _Axis:
    """An axis that holds all of its values."""

    def __init__(self, values: Sequence[float]) -> None:
        lower, upper = min(values), max(values)
        free = max(MARGIN * (upper - lower), NARROWEST * max(abs(lower), abs(upper))) or 1.0
        self.lower, self.upper = lower - free, upper + free

    def share(self, value: float) -> float:
        """Returns the place of a value, from 0 to 1."""
        return (value - self.lower) / (self.upper - self.lower)

    def ticks(self) -> list[float]:
        """Returns three to seven round values within the axis."""
        rough = (self.upper - self.lower) / 5
        power = 10.0 ** math.floor(math.log10(rough))
        step = power * min((each for each in (*_STEPS, 10.0) if each * power >= rough), default=10.0)
        first, last = math.ceil(self.lower / step), math.floor(self.upper / step)
        return [number * step + 0.0 for number in range(first, last + 1)]

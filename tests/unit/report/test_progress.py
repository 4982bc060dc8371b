"""Figures 10 and 11: what the lines and areas stand for."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import StepPatch
from tests.unit.report.rows import generation

from drivecal.report.figures.drawing import svg
from drivecal.report.figures.search import cells_figure, population_figure


def line(figure: Figure, name: str) -> Line2D:
    (found,) = [one for axes in figure.axes for one in axes.lines if one.get_gid() == name]
    return found


def areas(figure: Figure) -> dict[str, StepPatch]:
    patches = figure.axes[0].patches
    return {str(one.get_gid()): one for one in patches if isinstance(one, StepPatch) and one.get_gid()}


def test_the_population_is_drawn_as_it_was() -> None:
    figure = population_figure([generation(0), generation(1, mean=None), generation(2, alternatives=7)], baseline=4.5)
    np.testing.assert_equal(line(figure, "population.best").get_xydata(), [[1, 5], [2, 6], [3, 7]])
    np.testing.assert_equal(line(figure, "population.mean").get_ydata(), [3, np.nan, 3])
    np.testing.assert_equal(line(figure, "population.alternatives").get_ydata(), [2, 2, 7])
    np.testing.assert_equal(line(figure, "population.baseline").get_ydata(), [4.5, 4.5])
    text = svg(figure, "test")
    assert "Sets with the best objective, 7.000" in text
    for label in ("best", "mean", "worst", "baseline", "number of parameter sets"):
        assert f">{label}</text>" in text


def test_lines_differ_in_more_than_colour() -> None:
    figure = population_figure([generation(0), generation(1)])
    styles = {(one.get_linestyle(), one.get_marker()) for one in figure.axes[0].lines}
    assert len(styles) == len(figure.axes[0].lines) == 3


def test_an_iteration_that_is_not_answered_yet_has_no_point() -> None:
    pending = generation(1, best=None, mean=None, minimum=None, alternatives=0)
    figure = population_figure([generation(0), pending])
    for name, value in (("best", 5), ("alternatives", 2)):
        np.testing.assert_equal(line(figure, f"population.{name}").get_ydata(), [value, np.nan])
    assert "Sets with the best objective, 5.000" in svg(figure, "test")


@pytest.mark.parametrize("iterations", [1, 2, 300])
def test_cells_are_added_up_and_each_is_counted_once(iterations: int) -> None:
    figure = cells_figure([generation(number) for number in range(iterations)])
    found = areas(figure)
    assert list(found) == ["cells.simulated", "cells.audited", "cells.failed", "cells.repeated", "cells.reused"]
    tops = {name: part.get_data()[0] for name, part in found.items()}
    steps = np.arange(1, iterations + 1)
    np.testing.assert_allclose(tops["cells.simulated"], 20 * steps)
    np.testing.assert_allclose(tops["cells.audited"], 24 * steps)
    np.testing.assert_allclose(tops["cells.reused"], 40 * steps)
    assert f"{40 * iterations:,} requested cells, 37.5% answered without a simulation" in svg(figure, "test")


def test_predicted_cells_are_drawn_among_those_without_a_simulation() -> None:
    figure = cells_figure([generation(0, predicted=20, requested=60), generation(1)])
    tops = {name: part.get_data()[0] for name, part in areas(figure).items()}
    assert list(tops)[-3:] == ["cells.predicted", "cells.repeated", "cells.reused"]
    np.testing.assert_allclose(tops["cells.predicted"], [45, 70])
    assert "100 requested cells, 50.0% answered without a simulation" in svg(figure, "test")

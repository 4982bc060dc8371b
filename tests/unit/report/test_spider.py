"""Figure 9: what is grey, where, and that everything can be read."""

import re
from itertools import combinations
from xml.etree import ElementTree as ET

import numpy as np
import numpy.typing as npt
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from tests.unit.report.rows import ROWS, nowhere, row

from drivecal.contracts.tables import InfluenceRow
from drivecal.report.figures.drawing import PANELS_PER_SHEET, png, svg
from drivecal.report.figures.spider import HUB, overview_figures
from drivecal.report.sections import segment

TITLES = {"S1": "Change lane on a curved road to overtake a slower vehicle", "S2": "Keep the lane"}
LARGE = [
    row(f"S{scenario}", f"P{number}", -750.5, 1999, space_lower=-1500, space_upper=2000, unit="m/s²")
    for scenario in range(1, 7)
    for number in range(1, 12)
]


def ids(figure: Figure) -> list[str]:
    """Of the parts of the drawing that stand for something."""
    return [
        found
        for found in re.findall(r'id="([^"]+)"', svg(figure, "test"))
        if re.search(r"\.(range|influential|unknown)$", found)
    ]


def texts(figure: Figure) -> list[str]:
    found = ET.fromstring(svg(figure, "test")).iter("{http://www.w3.org/2000/svg}text")
    return ["".join(one.itertext()).strip() for one in found]


def corners(figure: Figure, name: str) -> npt.NDArray[np.float64]:
    """Of the bars with that name, shape (n, 5, 2): their four corners and the first again; 1 is the rim's radius."""
    paths = [patch.get_path() for patch in figure.axes[0].patches if re.fullmatch(name, str(patch.get_gid()))]
    return np.array([path.vertices for path in paths], dtype=np.float64)


def alone(rows: list[InfluenceRow]) -> Figure:
    """Returns the sheet of one scenario."""
    (figure,) = overview_figures(rows, TITLES)
    return figure


def test_each_parameter_has_an_axis_and_each_influence_a_segment() -> None:
    (figure,) = overview_figures(ROWS, TITLES)
    assert sorted(ids(figure)) == sorted(
        [f"{scenario}.P{number}.range" for scenario in ("S1", "S2") for number in (1, 2, 3)]
        + ["S1.P1.influential", "S1.P2.influential", "S2.P2.influential", "S2.P3.influential"]
    )
    shown = texts(figure)
    assert [shown.count(text) for text in ("S1", "S2", "P1", "P2", "P3", "Keep the lane")] == [1, 1, 2, 2, 2, 1]
    assert {"influential", "not influential"} <= set(shown)


def test_a_segment_begins_and_ends_where_the_influence_does() -> None:
    figure = alone([nowhere("S1", "P1"), row("S1", "P2", 2, 7.5)])
    (bar,) = corners(figure, "S1.P2.influential")
    along = -bar[:, 1]  # the second of two axes points downwards
    assert along.min() == pytest.approx(HUB + (1 - HUB) * 0.2)
    assert along.max() == pytest.approx(HUB + (1 - HUB) * 0.75)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (row(lower=2, upper=7.5), (0.2, 0.75)),
        (row(lower=-4, upper=14, space_lower=-15, space_upper=14), (11 / 29, 1.0)),
        (nowhere("S1", "P1"), None),
        (row(lower=None, upper=None), (0.0, 1.0)),
        (row(lower=2, upper=3, space_lower=None, space_upper=None), (0.0, 1.0)),
    ],
)
def test_bounds_are_normalised_to_the_range(given: InfluenceRow, expected: tuple[float, float] | None) -> None:
    assert segment(given) == (None if expected is None else pytest.approx(expected))


def test_a_single_influential_value_is_still_seen() -> None:
    figure = alone([row("S1", "P1", 10, 10)])
    (bar,) = corners(figure, "S1.P1.influential")
    assert np.ptp(bar[:, 1]) > 0.004
    assert bar[:, 1].max() <= 1 + 1e-9


def test_what_is_unknown_is_hatched_and_named() -> None:
    figure = alone([row("S1", "P1", unknown=True), row("S1", "P2")])
    assert {"S1.P1.unknown", "S1.P2.influential"} <= set(ids(figure))
    assert "S1.P1.influential" not in ids(figure)
    assert "unknown, counts as influential" in texts(figure)
    assert "unknown, counts as influential" not in texts(alone(ROWS[:3]))


def test_many_scenarios_take_several_sheets() -> None:
    sheets = overview_figures([row(f"S{number}") for number in range(PANELS_PER_SHEET + 2)], {})
    assert [sum(bool(axes.patches) for axes in sheet.axes) for sheet in sheets] == [PANELS_PER_SHEET, 2]


def test_no_text_covers_another_and_none_leaves_the_page() -> None:
    (figure,) = overview_figures(LARGE, dict.fromkeys((f"S{i}" for i in range(1, 7)), TITLES["S1"]))
    FigureCanvasAgg(figure)
    figure.draw_without_rendering()
    found = [one for one in figure.findobj(Text) if one.get_visible() and one.get_text()]
    boxes = [(one.get_text(), one.get_window_extent()) for one in found]
    page = figure.bbox
    for text, box in boxes:
        assert page.x0 <= box.x0 <= box.x1 <= page.x1, text
        assert page.y0 <= box.y0 <= box.y1 <= page.y1, text
    for (one, first), (other, second) in combinations(boxes, 2):
        assert not first.overlaps(second), (one, other)


def test_the_same_data_give_the_same_bytes() -> None:
    one, other = (alone(ROWS[:3]) for _ in range(2))
    assert svg(one, "figure") == svg(other, "figure")
    assert png(one) == png(other)
    assert png(one).startswith(b"\x89PNG")

"""Figures 12 and 14, Tables 1, 2 and 9: against what was found."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from tests.support.scales import COST
from tests.unit.report.rows import OPTIMA, PARAMETERS, ROBUST, VALIDATED, findings, optimum, robust, study, trial, validated

from drivecal.analysis.robustness import vehicles_text
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.results import StudyResult
from drivecal.domain.scales import COMFORT
from drivecal.report import robustness, sections
from drivecal.report.blocks import Table
from drivecal.report.figures import optima_coordinates, studies
from drivecal.report.figures.drawing import KINDS, svg


def lines(figure: Figure, name: str) -> list[list[list[float]]]:
    found = [one for one in figure.axes[0].collections if isinstance(one, LineCollection) and one.get_gid() == name]
    return [np.asarray(segment).tolist() for one in found for segment in one.get_segments()]


def bars(figure: Figure) -> dict[str, Rectangle]:
    return {
        str(one.get_gid()): one for axes in figure.axes for one in axes.patches if isinstance(one, Rectangle) and one.get_gid()
    }


def test_each_best_set_is_a_line_through_its_values_in_the_searched_ranges() -> None:
    worse = [one for one in findings().solutions if one.rank > len(OPTIMA)]
    figure = optima_coordinates.drawn(OPTIMA, findings().solutions, PARAMETERS).figure
    assert lines(figure, "optima.0") == [[[0, 0.55], [1, 0.5]], [[0, 0.55], [1, 0.6]]]
    assert lines(figure, "optima.1") == [[[0, 0.55], [1, 1.0]]]
    assert lines(figure, "optima.worse") == [[[0, 0.0], [1, 0.0]]]
    assert len(worse) == 1
    text = svg(figure, "test")
    assert "region 0: 2 sets" in text
    assert "P3" not in text, "what is held is not searched"


def test_values_that_all_best_sets_share_are_named() -> None:
    assert sections.constant(OPTIMA, PARAMETERS[:2]) == {"P1": 1}
    assert sections.constant(OPTIMA[:1], PARAMETERS[:2]) == {}


def test_regions_beyond_the_kinds_of_lines_are_drawn_together() -> None:
    many = [optimum(number + 1, number, 1, region=number) for number in range(len(KINDS) + 3)]
    figure = optima_coordinates.drawn(many, many, PARAMETERS).figure
    assert len(lines(figure, f"optima.{len(KINDS)}")) == 3
    assert "3 other regions: 3 sets" in svg(figure, "test")


def rows_of(blocks: Sequence[object]) -> list[list[list[str]]]:
    return [[[str(value) for value in row] for row in block.rows] for block in blocks if isinstance(block, Table)]


def test_regions_tell_how_far_the_nearest_worse_set_is() -> None:
    (regions,) = rows_of(sections.optima_blocks(OPTIMA, 3, PARAMETERS, []))
    assert regions == [["0", "2", "1", "0.100", "0.200"], ["1", "1", "2", "0.500", "0.500"]]


def test_a_bar_ends_where_the_boxes_end_and_says_where_the_condition_broke() -> None:
    figure = studies.robustness_figure(ROBUST)
    found = bars(figure)
    assert sorted(found) == ["box.1.1", "box.1.2", "box.2.1", "box.2.2", "box.3.1"]
    assert found["box.1.2"].get_x() == pytest.approx(0.1)
    assert found["box.1.2"].get_x() + found["box.1.2"].get_width() == pytest.approx(0.2)
    assert {name for name, bar in found.items() if bar.get_hatch()} == {"box.2.2", "box.3.1"}
    assert [np.asarray(line.get_xdata()).tolist() for line in figure.axes[0].lines] == [[0.2, 0.2], [0.1, 0.1], [0.0, 0.0]]
    numbers = [text.get_text() for text in figure.axes[0].texts]
    assert numbers == ["0", "1", "0", "3", "–"], "a vehicle without a result has no deviation"


@pytest.mark.parametrize(
    ("settings", "expected"),
    [({}, {"S1": 3.0, "S2": 2.0}), ({"eta": [3, 1]}, {"S2": 2.0}), ({"condition": "mean", "eta": 3}, {"S1": 3.0})],
)
def test_the_scenarios_that_broke_the_condition_are_named(settings: dict[str, Any], expected: dict[str, float]) -> None:
    assert robustness.limits(ROBUST[1], study(**settings).settings) == expected
    assert robustness.limits(ROBUST[0], study(**settings).settings) == {}
    assert robustness.limits(ROBUST[2], study(**settings).settings)["S1"] is None


CAMPAIGN = Campaign(id="0" * 32, name="c", state="succeeded")


def test_the_nominal_ranks_begin_with_the_best_score_and_end_with_none() -> None:
    rows = [*ROBUST, robust(3, 0, [trial(1, False, None)], objective=None).model_copy(update={"rank": 4})]
    assert robustness.by_nominal(rows) == {2: 1, 1: 2, 3: 3, 4: 4}
    assert robustness.by_nominal(rows, sign=-1) == {3: 1, 1: 2, 2: 3, 4: 4}


def test_table_9_sets_robust_beside_nominal_quality() -> None:
    other = StudyResult(
        study=study(campaign="2" * 32, condition="mean", eta=0.2), robustness=[robust(2, 2, [trial(1, True, 0)])]
    )
    blocks = robustness.robustness_blocks([StudyResult(study=study(), robustness=ROBUST), other], OPTIMA, CAMPAIGN, [])
    quality = next(block for block in blocks if isinstance(block, Table))
    assert list(quality.header[6:]) == ["degree: max ≤ 1, δ = 0.1", "degree: mean < 0.2, δ = 0.1", "δ max", "limited by"]
    first, second, third = rows_of(blocks)[0]
    assert first == ["1 *", "2", "6.0000", "5.100", "5", "7", "≥ 2", "None", "0.2", "None"]
    assert second == ["2", "1", "6.0000", "5.200", "5", "7", "1", "≥ 2", "0.1", "S1 (3), S2 (2)"]
    assert third == ["3", "3", "5.5000", "5.300", "5", "7", "0", "None", "0", "S1 (no result)"]


@pytest.mark.parametrize(("samples", "share"), [(1, "95.0%"), (30, "9.5%"), (300, "1.0%")])
def test_a_box_that_holds_says_what_its_vehicles_do_not_exclude(samples: int, share: str) -> None:
    assert share in vehicles_text({"samples": samples, "condition": "max"})
    assert "%" not in vehicles_text({"samples": samples, "condition": "mean"})


def test_the_histogram_has_a_bar_for_each_deviation_and_hatches_what_is_wrong() -> None:
    (drawn,) = studies.validation(VALIDATED)
    found = bars(drawn.figure)
    assert {name: bar.get_height() for name, bar in found.items()} == {"S1.0": 90, "S1.-1": 4, "S1.2": 5, "S1.-7": 1}
    assert {name for name, bar in found.items() if bar.get_hatch()} == {"S1.2", "S1.-7"}
    assert len(drawn.figure.axes) == 1, "where nothing was compared there is nothing to draw"
    assert list(studies.validation(VALIDATED[1:])) == []


def test_a_validation_has_sample_sizes_and_error_rates() -> None:
    ((first, empty),) = rows_of(sections.validation_tables(VALIDATED, COMFORT))
    assert first == ["S1", "2", "3", "3", "40", "20", "5", "100", "10", "6", "6.00%", "0.00%", "50.00%"]
    assert empty[7:] == ["0", "0", "0", "None", "None", "None"]


def test_costs_without_steps_are_drawn_in_bars_with_edges_at_the_tolerance() -> None:
    known = validated("S1", {0: 90, -1: 4, 2: 5, 26: 1})
    costs = known.model_copy(update={"histogram_step": COST.bin, "different": 20})
    (drawn,) = studies.validation([costs], COST)
    found = bars(drawn.figure)
    assert {name: bar.get_x() + bar.get_width() / 2 for name, bar in found.items()} == pytest.approx(
        {"S1.0": 0, "S1.-1": -4, "S1.2": 8, "S1.26": 104}
    )
    assert {name for name, bar in found.items() if bar.get_hatch()} == {"S1.-1", "S1.2", "S1.26"}
    assert drawn.figure.axes[0].get_xlim()[1] > 104

"""Sections of problem.yaml from the characteristics of files, and files of names."""

from dataclasses import replace
from typing import Any

import pytest
from tests.support.values import faulty_fields

from drivecal.calibration_data import dcm
from drivecal.calibration_data.characteristics import Axis, Characteristic, index
from drivecal.calibration_data.files import labels_of
from drivecal.calibration_data.sections import axis_points, chosen_by, joined, sections_of
from drivecal.contracts.specification import ParameterEntry
from drivecal.domain.errors import InvalidInputError
from drivecal.domain.parameters import Parameter


def entry(characteristic: Characteristic, span: float = 0.5) -> dict[str, Any]:
    sections = sections_of([characteristic], {}, span)
    fields = sections.parameters[characteristic.name]
    Parameter.declared(characteristic.name, **ParameterEntry.model_validate(fields).model_dump())  # a problem takes it
    return fields


@pytest.mark.parametrize(
    ("characteristic", "expected"),
    [
        (Characteristic("a", 1.0, "m", "text", 0.0, 2.0), {"lower": 0.0, "upper": 2.0, "unit": "m", "description": "text"}),
        (Characteristic("a", lower=0.0, upper=1.05, step=0.1), {"lower": 0.0, "upper": 1.0, "step": 0.1}),
        (Characteristic("a", lower=0.0, upper=1.0, step=2.0**-10), {"lower": 0.0, "upper": 1.0}),
        (Characteristic("a", lower=1.0, upper=9.0, integer=True), {"lower": 1, "upper": 9, "integer": True}),
        (Characteristic("a", "eco", choices=("eco", "sport")), {"choices": ["eco", "sport"]}),
        (Characteristic("a", -4.0), {"lower": -6.0, "upper": -2.0}),
        (Characteristic("a", 0.0, lower=-3.4e38, upper=3.4e38), {"lower": -0.5, "upper": 0.5}),
        (Characteristic("a", 12.0, lower=10.0, upper=3.4e38), {"lower": 10.0, "upper": 18.0}),
        (Characteristic("a", 0.0, lower=0.0, upper=4294967295.0, integer=True), {"lower": 0, "upper": 1, "integer": True}),
        (Characteristic("a", lower=2.4e-9, upper=8.6e-9), {"lower": 3e-9, "upper": 8e-9}),
    ],
)
def test_an_entry_is_one_that_a_problem_takes(characteristic: Characteristic, expected: dict[str, Any]) -> None:
    assert entry(characteristic) == expected


@pytest.mark.parametrize(
    "characteristic",
    [
        Characteristic("a", 3.7e-9, lower=2.4e-9, upper=8.6e-9),
        Characteristic("a", 4e-10, lower=0.0, upper=1e-6),
        Characteristic("a", lower=0.2, upper=0.8, integer=True),
    ],
)
def test_what_a_parameter_cannot_hold_is_refused(characteristic: Characteristic) -> None:
    with pytest.raises(InvalidInputError, check=lambda error: error.problems[0].field == "a"):
        sections_of([characteristic], {}, 0.5)


def test_a_name_with_brackets_is_matched_as_it_is() -> None:
    members = [Characteristic("k[0]", 1.0), Characteristic("k0", 1.0)]
    assert [each.name for each in chosen_by(members, ["k[0]"])] == ["k[0]", "k0"]


def test_a_label_that_is_another_parameters_name_is_refused() -> None:
    with pytest.raises(InvalidInputError, check=lambda error: error.problems[0].field == "P1"):
        labels_of({"P1": "P2"}, ["P1", "P2"])
    assert labels_of({"P1": "P2", "P2": "P1"}, ["P1", "P2"]) == {"P1": "P2", "P2": "P1"}


def test_values_are_those_of_the_parameter_or_refused() -> None:
    mode = Characteristic("mode", 1.0, choices=("off", "on"), codes=(0.0, 1.0))
    whole = Characteristic("n", 3.0, lower=0.5, upper=9.5, integer=True)
    sections = sections_of([mode, whole], {}, 0.5)
    assert sections.baseline == {"mode": "on", "n": 3}
    assert (sections.parameters["n"]["lower"], sections.parameters["n"]["upper"]) == (1, 9)
    wrong = [replace(mode, value=7.0), replace(whole, value=2.5), Characteristic("tiny", 2e-10, lower=1e-10, upper=4e-10)]
    assert faulty_fields(sections_of, wrong, {}, 0.5) == ["mode", "n", "tiny"]


@pytest.mark.parametrize(
    ("value", "step", "expected"),
    [
        (0.30000001192092896, 0.1, 0.3),  # 0.3 in single precision
        (0.30000001192092896, None, 0.300000012),
        (2.4000000953674316, None, 2.4),  # the upper end
        (2.4000000953674316, 0.1, 2.4),
        (0.34, 0.1, 0.34),  # off the grid: left to the check of the problem
        (1 / 3, None, 0.333333333),
    ],
)
def test_a_start_value_of_single_precision_is_on_the_grid(value: float, step: float | None, expected: float) -> None:
    sections = sections_of([Characteristic("a", value, lower=0.0, upper=2.4, step=step)], {}, 0.5)
    assert sections.baseline == {"a": expected}


def test_labels_that_are_no_names_are_bound_by_a_map_or_refused() -> None:
    given = [Characteristic("_gap[0]", 1.0), Characteristic("v0", 1.0)]
    assert list(sections_of(given, {"_gap[0]": "gap"}, 0.5).parameters) == ["gap", "v0"]
    assert faulty_fields(sections_of, [*given, Characteristic("text", 2.0), Characteristic("none")], {"v0": "text"}, 0.5) == [
        "_gap[0]",
        "text",
        "none",
    ]


def test_texts_whose_choices_no_file_has_are_left_out() -> None:
    mode, gap = Characteristic("mode", "sport", choices=("eco", "sport")), Characteristic("gap", 1.5, lower=1.0, upper=2.0)
    exported = dcm.read(dcm.write([mode, gap]), "best.dcm").characteristics
    sections = sections_of(exported, {}, 0.5)
    assert (list(sections.parameters), sections.baseline, sections.left_out) == (
        ["gap"],
        {"gap": 1.5},
        {"mode": sections.left_out["mode"]},
    )
    known = sections_of(joined([[mode], exported]), {}, 0.5)
    assert (known.parameters["mode"], known.baseline["mode"]) == ({"choices": ["eco", "sport"]}, "sport")
    assert known.left_out == {}
    with pytest.raises(InvalidInputError):
        sections_of(exported[:1], {}, 0.5)


def test_what_an_a2l_lacks_is_taken_from_another_file_or_named() -> None:
    std, com, res = Axis("STD_AXIS", unit="m"), Axis("COM_AXIS", unit="m", shared="s"), Axis("RES_AXIS", shared="r")
    described = [
        Characteristic("own", lower=0.0, upper=9.0, step=0.5, kind="CURVE", axes=(replace(std, lower=0.0, upper=7.0),)),
        Characteristic("group", lower=0.0, upper=9.0, integer=True, kind="MAP", axes=(com, std)),
        Characteristic("scaled", lower=0.0, upper=9.0, unit="s", kind="CURVE", axes=(res,)),
        Characteristic("s", lower=0.0, upper=99.0, kind="COM_AXIS", axes=(index(8),)),
    ]
    free = Characteristic("free", 2.0)
    alone = sections_of([*described[:3], free], {}, 0.1)
    assert (alone.parameters, list(alone.left_out)) == ({"free": {"lower": 1.8, "upper": 2.2}}, ["own", "group", "scaled"])
    assert (alone.guessed, "(s)" in alone.left_out["group"]) == (["free"], True)
    held = [
        Characteristic("own", kind="CURVE", axes=(replace(std, points=(1.0, 2.0, 4.0)),), values=(3.0, 2.0, 0.5)),
        Characteristic("group", kind="MAP", axes=(com, replace(std, points=(5.0, 6.0))), values=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0)),
        Characteristic("scaled", kind="CURVE", axes=(index(2, "RES_AXIS"),), values=(1.0, 2.0)),
        Characteristic("s", kind="COM_AXIS", axes=(index(3),), values=(10.0, 20.0, 30.0)),
    ]
    for given in ([described, held], [held, described]):
        known = joined(given)
        made = sections_of([*known, *axis_points(known)], {}, 0.5)
        axes = {"x": [10.0, 20.0, 30.0], "y": [5.0, 6.0], "x_unit": "m", "y_unit": "m"}
        assert made.parameters["group"] == {"map": axes, "lower": 0, "upper": 9, "step": 1}
        curve = {"axis": [1.0, 2.0, 4.0], "axis_unit": "m"}
        assert made.parameters["own"] == {"curve": curve, "lower": 0.0, "upper": 9.0, "step": 0.5}
        assert made.parameters["scaled"] == {"curve": {"axis": [0.0, 1.0]}, "lower": 0.0, "upper": 9.0, "unit": "s"}
        assert (made.parameters["own.x"]["monotone"], made.parameters["own.x"]["upper"]) == ("increasing", 7.0)
        points = {"own.x": [1.0, 2.0, 4.0], "s": [10.0, 20.0, 30.0], "group": [[1.0, 4.0], [2.0, 5.0], [3.0, 6.0]]}
        assert {name: made.baseline[name] for name in points} == points
    three = Characteristic("group", kind="MAP", axes=(com, replace(std, points=(5.0, 6.0))), values=(1.0, 2.0))
    for first, other in (
        (described[0], Characteristic("own", 1.0)),
        (described[2], replace(held[2], unit="min")),
        (held[3], three),
    ):
        assert faulty_fields(sections_of, joined([[first], [other]]), {}, 0.5)[:1] == [other.name]
    fixed = sections_of([replace(described[0], axes=(Axis("FIX_AXIS"),)), free], {}, 0.1)
    assert "(FIX_AXIS), which needs a linear conversion" in fixed.left_out["own"]
    flat = replace(held[0], axes=(replace(std, points=(1.0, 1.0, 4.0)),))
    assert list(sections_of([flat, free], {}, 0.5).left_out) == ["own"]


def test_characteristics_are_chosen_by_their_names() -> None:
    given = [Characteristic(f"ACC_{index}") for index in range(201)] + [Characteristic("ABS_1")]
    assert [row.name for row in chosen_by(given, ["ABS_*", "ACC_7"])] == ["ACC_7", "ABS_1"]
    for patterns in ([], ["ACC_*"], ["ESP*"]):
        assert faulty_fields(chosen_by, given, patterns) == ["--match"]
    assert faulty_fields(chosen_by, [], []) == ["files"]


def test_a_file_of_names_is_checked_whole() -> None:
    assert labels_of({"P1": "ACC_a", "P4": "ACC_b"}, ["P1", "P2"]) == {"P1": "ACC_a", "P4": "ACC_b"}  # of all problems
    assert faulty_fields(
        labels_of, {"P1": "ACC_a", "P2": "ACC_a", "P4": "x", "P3": "two words", "P5": 1}, ["P1", "P2", "P3", "P5"]
    ) == ["P2", "P3", "P5"]

"""Sections of problem.yaml from the characteristics of files, and files of names."""

from dataclasses import replace
from typing import Any

import pytest

from drivecal.bundles.manifest import ParameterEntry
from drivecal.calibration_data import dcm
from drivecal.calibration_data.characteristics import Characteristic
from drivecal.calibration_data.files import labels_of
from drivecal.calibration_data.sections import chosen_by, joined, sections_of
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


def test_ranges_of_one_file_join_values_of_another() -> None:
    sections = sections_of(
        joined([[Characteristic("g", lower=0.5, upper=3.0, unit="s")], [Characteristic("g", 1.5), Characteristic("h", 2.0)]]),
        {},
        0.1,
    )
    assert sections.parameters == {"g": {"lower": 0.5, "upper": 3.0, "unit": "s"}, "h": {"lower": 1.8, "upper": 2.2}}
    assert sections.baseline == {"g": 1.5, "h": 2.0}
    assert sections.guessed == ["h"]


def test_values_are_those_of_the_parameter_or_refused() -> None:
    mode = Characteristic("mode", 1.0, choices=("off", "on"), codes=(0.0, 1.0))
    whole = Characteristic("n", 3.0, lower=0.5, upper=9.5, integer=True)
    sections = sections_of([mode, whole], {}, 0.5)
    assert sections.baseline == {"mode": "on", "n": 3}
    assert (sections.parameters["n"]["lower"], sections.parameters["n"]["upper"]) == (1, 9)
    wrong = [replace(mode, value=7.0), replace(whole, value=2.5), Characteristic("tiny", 2e-10, lower=1e-10, upper=4e-10)]
    with pytest.raises(InvalidInputError) as refused:
        sections_of(wrong, {}, 0.5)
    assert [problem.field for problem in refused.value.problems] == ["mode", "n", "tiny"]


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
def test_a_start_value_is_on_the_grid_if_only_single_precision_put_it_beside(
    value: float, step: float | None, expected: float
) -> None:
    sections = sections_of([Characteristic("a", value, lower=0.0, upper=2.4, step=step)], {}, 0.5)
    assert sections.baseline == {"a": expected}


def test_labels_that_are_no_names_are_bound_by_a_map_or_refused() -> None:
    given = [Characteristic("_gap[0]", 1.0), Characteristic("v0", 1.0)]
    assert list(sections_of(given, {"_gap[0]": "gap"}, 0.5).parameters) == ["gap", "v0"]
    with pytest.raises(InvalidInputError) as refused:
        sections_of([*given, Characteristic("text", 2.0), Characteristic("none")], {"v0": "text"}, 0.5)
    assert [problem.field for problem in refused.value.problems] == ["_gap[0]", "text", "none"]


def test_texts_whose_choices_no_file_has_are_left_out() -> None:
    mode, gap = Characteristic("mode", "sport", choices=("eco", "sport")), Characteristic("gap", 1.5, lower=1.0, upper=2.0)
    exported = dcm.read(dcm.write([mode, gap]), "best.dcm").characteristics
    sections = sections_of(exported, {}, 0.5)
    assert (list(sections.parameters), sections.baseline, sections.left_out) == (["gap"], {"gap": 1.5}, ["mode"])
    known = sections_of(joined([[mode], exported]), {}, 0.5)
    assert (known.parameters["mode"], known.baseline["mode"]) == ({"choices": ["eco", "sport"]}, "sport")
    assert known.left_out == []
    with pytest.raises(InvalidInputError):
        sections_of(exported[:1], {}, 0.5)


def test_characteristics_are_chosen_by_their_names() -> None:
    given = [Characteristic(f"ACC_{index}") for index in range(201)] + [Characteristic("ABS_1")]
    assert [row.name for row in chosen_by(given, ["ABS_*", "ACC_7"])] == ["ACC_7", "ABS_1"]
    for patterns in ([], ["ACC_*"], ["ESP*"]):
        with pytest.raises(InvalidInputError) as refused:
            chosen_by(given, patterns)
        assert [problem.field for problem in refused.value.problems] == ["--match"]
    with pytest.raises(InvalidInputError) as refused:
        chosen_by([], [])
    assert [problem.field for problem in refused.value.problems] == ["files"]


def test_a_file_of_names_is_checked_whole() -> None:
    assert labels_of({"P1": "ACC_a", "P2": "ACC_b"}, ["P1", "P2", "P3"]) == {"P1": "ACC_a", "P2": "ACC_b"}
    with pytest.raises(InvalidInputError) as refused:
        labels_of({"P1": "ACC_a", "P2": "ACC_a", "P4": "x", "P3": "two words", "P5": 1}, ["P1", "P2", "P3", "P5"])
    assert [problem.field for problem in refused.value.problems] == ["P2", "P4", "P3", "P5"]

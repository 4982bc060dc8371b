"""Curves and maps: their values keep the declared form, and sets of users become coefficients."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BSpline
from tests.support.values import faults_of, faulty_fields, present

from drivecal import local
from drivecal.bundles.checks import checked
from drivecal.bundles.expressions import Constraint
from drivecal.bundles.fingerprints import setup_document
from drivecal.bundles.installed import Bundle
from drivecal.bundles.shapes import Shape, ShapeEntry, with_coefficients, with_points
from drivecal.campaigns.cells.earlier import earlier_version
from drivecal.campaigns.resolve.problem import resolve, resolve_evaluation
from drivecal.campaigns.resolve.workbench import constraints_of, parameters_of
from drivecal.contracts.specification import CampaignSpecification, EvaluationSpecification
from drivecal.domain.constraints import Constraints
from drivecal.domain.errors import InvalidInputError
from drivecal.domain.parameters import ParameterSpace

AXIS = [0.0, 5.0, 10.0, 20.0, 40.0, 45.0]
GAIN: dict[str, Any] = {"curve": {"axis": AXIS, "axis_unit": "m/s"}, "lower": 0.2, "upper": 3.2, "unit": "1/s"}
TORQUE: dict[str, Any] = {"map": {"x": [0, 1, 2, 4], "y": [0, 10, 30]}, "lower": 0, "upper": 300}
FORMS = ["increasing", "decreasing", "convex", "concave", "slope"]
MODEL = """
def evaluate(parameters, scenario):
    gain, torque = parameters["gain"], parameters["torque"]
    assert isinstance(gain, list) and all(isinstance(row, list) for row in torque)
    return {"error": sum((a - b) ** 2 for a, b in zip(gain, scenario["gain"])), "corner": torque[-1][0]}
"""


def document(gain: dict[str, Any], torque: dict[str, Any] | None = None, **others: Any) -> dict[str, Any]:
    """Returns a manifest with a curve and a map."""
    return {
        "problem": "shaped",
        "parameters": {"a": {"lower": 0, "upper": 1}, "gain": GAIN | gain, "torque": TORQUE | (torque or {})},
        "simulator": {"kind": "python", "file": "model.py", "deterministic": True},
        "scenarios": {"city": {"gain": [3, 2, 1.5, 1, 0.5, 0.5]}},
        "measures": {"error": "1", "corner": "Nm"},
        "scores": {"error": {"formula": "error", "direction": "minimise", "range": [0, 20]}},
    } | others


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1), form=st.sampled_from(FORMS), n=st.integers(2, 6))
def test_feasible_coefficients_give_values_of_the_declared_form(seed: int, form: str, n: int) -> None:
    declared = {"monotone": form} if form.endswith("ing") else {form: 0.05 if form == "slope" else True}
    manifest = checked(document({"coefficients": n} | declared))
    constraints = Constraints(ParameterSpace(parameters_of(manifest)), constraints_of(manifest))
    generator, shape = np.random.default_rng(seed), manifest.shapes["gain"]
    [row] = constraints.whole_region.sample(1, generator)
    other = constraints.space.parameter_set(row.tolist()).floats
    values = np.array(shape.values(other))
    slopes = np.diff(values) / np.diff(AXIS)
    assert ((values >= GAIN["lower"]) & (values <= GAIN["upper"])).all()
    kept = {
        "increasing": slopes >= -1e-8,
        "decreasing": slopes <= 1e-8,
        "convex": np.diff(slopes) >= -1e-8,
        "concave": np.diff(slopes) <= 1e-8,
        "slope": abs(slopes) <= 0.05 + 1e-8,
    }
    assert kept[form].all()
    if n == len(AXIS):  # single points are taken as they are
        return
    wanted = np.sort(generator.uniform(0.2, 3.2, 6))[:: -1 if form == "decreasing" else 1]
    nearest = shape.settings(wanted.tolist(), "gain")
    assert all(Constraint(text).holds(nearest) for text in shape.conditions)
    off, off_other = (shape.weights[0] @ [float(each[name]) for name in shape.names] - wanted for each in (nearest, other))
    towards = off + 0.01 * (off_other - off)
    assert off @ off <= towards @ towards + 1e-8, "no feasible curve is nearer"


@given(st.lists(st.floats(0.2, 3.2), min_size=4, max_size=4))
def test_a_curve_is_the_spline_of_scipy_with_the_same_coefficients(coefficients: list[float]) -> None:
    shape = Shape.declared("gain", ShapeEntry.model_validate(GAIN | {"coefficients": 4}))
    knots = [0, 0, 0, 15, 45, 45, 45]  # 15: the middle between the third and the fourth of six points
    expected = BSpline(knots, coefficients, 2)(AXIS)
    assert shape.values(dict(zip(shape.names, coefficients, strict=True))) == pytest.approx(expected.tolist(), abs=1e-9)


@pytest.mark.parametrize("step", [None, 0.05])
def test_values_become_the_coefficients_that_give_them(step: float | None) -> None:
    manifest = checked(document({"coefficients": 4, "step": step}, {"coefficients": 6}))
    gain, torque = manifest.shapes["gain"], manifest.shapes["torque"]
    assert torque.counts == (3, 2)
    curve = dict(zip(gain.names, [3.0, 2.5, 1.0, 0.25], strict=True))
    near = 1e-6 if step is None else 3 * step  # values are rounded to the step
    assert gain.settings(gain.values(curve), "gain") == pytest.approx(curve, abs=near)
    settings = dict(zip(torque.names, [0.0, 300.0, 20.0, 10.0, 50.0, 60.0], strict=True))
    assert torque.settings(torque.values(settings), "torque") == pytest.approx(settings)


def test_single_points_keep_their_values_and_their_stored_runs_when_the_axis_changes() -> None:
    manifest = checked(document({}))
    moved = checked(document({"curve": {"axis": [0, 6, 10, 20, 40, 45]}}))
    gain, values = checked(document({"step": 0.05})).shapes["gain"], [3, 2.123, 2, 1, 1, 1]
    assert gain.values(gain.settings(values, "gain")) == values, "as a worker passes them on"
    assert setup_document(manifest, "city", "f") == setup_document(moved, "city", "f")
    few, other = (checked(document({"coefficients": 3, "curve": {"axis": axis}})) for axis in (AXIS, [0, 6, 10, 20, 40, 45]))
    assert setup_document(few, "city", "f") != setup_document(other, "city", "f")


def test_an_fmu_gets_each_value_by_its_index() -> None:
    shape = Shape.declared("torque", ShapeEntry.model_validate(TORQUE))
    settings = {name: float(place) for place, name in enumerate(shape.names)}
    arguments = with_points(settings | {"a": 1.0}, {"torque": shape}, {"kind": "fmu"})
    assert arguments == {"a": 1.0} | {f"torque[{x + 1},{y + 1}]": 3.0 * x + y for x in range(4) for y in range(3)}


@pytest.mark.parametrize(
    ("gain", "field"),
    [
        ({"curve": {"axis": [0, 5, 5]}}, "parameters.gain.curve.axis"),
        ({"map": TORQUE["map"]}, "parameters.gain"),
        ({"monotone": "falling"}, "parameters.gain.monotone"),
        ({"monotone": {"x": "increasing"}}, "parameters.gain"),
        ({"convex": True, "step": 0.1, "coefficients": 3}, "parameters.gain"),
        ({"lower": 4}, "parameters.gain.upper"),
        ({"coefficient": 3}, "parameters.gain.coefficient"),
    ],
)
def test_a_wrong_curve_is_refused_at_its_field(gain: dict[str, Any], field: str) -> None:
    assert set(faulty_fields(checked, document(gain))) == {field}


def test_a_name_of_two_coefficients_or_of_a_varied_parameter_is_refused() -> None:
    assert faulty_fields(checked, document({}) | {"parameters": {"g": TORQUE, "g_1": GAIN}}) == ["parameters.g"]
    varied = {"gain_1": {"nominal": 1, "lower": 0, "upper": 2}}
    assert faulty_fields(checked, document({}, varied=varied)) == ["varied.gain_1"]


@pytest.mark.parametrize(
    ("baseline", "field"),
    [
        ({"gain": [1, 2]}, "baseline.gain"),
        ({"gain": 1}, "baseline.gain"),
        ({"a": [1, 2]}, "baseline.a"),
        ({"gain": [1, 2, 1, 1, 1, 1]}, "baseline.gain"),
        ({"torque": [[1, 2, 3]] * 3}, "baseline.torque"),
    ],
)
def test_a_baseline_that_does_not_fit_is_refused_at_its_field(baseline: dict[str, Any], field: str) -> None:
    given = {"a": 0.5, "gain": [1] * 6, "torque": [[0, 0, 0]] * 4} | baseline
    assert set(faulty_fields(checked, document({"monotone": "decreasing"}, baseline=given))) == {field}


@pytest.mark.parametrize("form", [{"convex": True}, {"concave": True}, {"slope": 0.02}, {"monotone": "increasing"}])
def test_a_line_on_the_grid_has_every_form(form: dict[str, Any]) -> None:
    line = {"a": 0.5, "gain": [0.2, 0.3, 0.4, 0.6, 1.0, 1.1], "torque": [[0, 0, 0]] * 4}
    assert checked(document({"step": 0.1} | form, baseline=line)).start is not None


def test_lists_in_a_campaign_become_coefficients() -> None:
    bundle = Bundle("d", "f", checked(document({"coefficients": 3}, {"coefficients": 4})))
    wanted = {"problem": "shaped", "fixed": {"torque": [[7, 7, 7]] * 4}, "baseline": {"a": 0.5, "gain": [1] * 6}}
    problem = resolve(CampaignSpecification.model_validate(wanted), lambda _: bundle)
    assert [each.name for each in problem.space.searched] == ["a", "gain_1", "gain_2", "gain_3"]
    assert problem.baseline is not None
    of_torque = {f"torque_{x}_{y}": 7 for x in (1, 2) for y in (1, 2)}
    assert problem.baseline.floats == {"a": 0.5, "gain_1": 1, "gain_2": 1, "gain_3": 1} | of_torque
    evaluated = EvaluationSpecification.model_validate(
        {"problem": "shaped", "parameters": {"a": 0.5, "gain": [1] * 6, "torque": [[7, 7, 7]] * 4}}
    )
    assert resolve_evaluation(evaluated, lambda _: bundle).specification.parameters == problem.baseline.floats
    assert (
        faults_of(resolve, CampaignSpecification.model_validate(wanted | {"fixed": {"a": [1]}}), lambda _: bundle)[0].field
        == "fixed.a"
    )


def test_a_simulator_gets_lists(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRIVECAL_BUNDLE_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "shaped"
    folder.mkdir()
    (folder / "model.py").write_text(MODEL)
    (folder / "problem.yaml").write_text(yaml.safe_dump(document({"coefficients": 3}, {"coefficients": 4})))
    torque = [[float(x)] * 3 for x in (0, 1, 2, 4)]
    [cell] = local.evaluate({"a": 0.5, "gain": [2.5] * 6, "torque": torque}, problem=folder).cells.values()
    assert cell.error is None
    assert cell.metrics == pytest.approx({"error": 0.25 + 0.25 + 1 + 2.25 + 4 + 4, "corner": 4})


def test_a_list_that_coefficients_cannot_give_is_noted() -> None:
    exact: dict[str, Any] = {"a": 0.5, "gain": [1] * 6, "torque": [[7, 7, 7]] * 4}
    manifest = checked(document({"coefficients": 3}, {"coefficients": 4}))
    notes = list[str]()
    assert with_coefficients(exact, manifest.shapes, "", notes=notes)
    assert notes == []
    wavy = exact | {"gain": [1, 2, 1, 2, 1, 2]}
    bundle = Bundle("d", "f", checked(document({"coefficients": 3}, {"coefficients": 4}, baseline=wavy)))
    sets = {"optimizer": {"kind": "surrogate", "start_sets": [wavy]}, "constraints": [{"changes": wavy, "at_most": 2}]}
    wanted = CampaignSpecification.model_validate({"problem": "shaped"} | sets)
    problem = resolve(wanted, lambda _: bundle)
    for noted in problem.notes, resolve(problem.specification, lambda _: bundle).notes:  # the dispatcher resolves it again
        fields = [note.partition(":")[0] for note in noted if "nearest" in note]
        assert sorted(fields) == ["baseline.gain", "constraints[0].changes.gain", "optimizer.start_sets[0].gain"]
    single = EvaluationSpecification(problem="shaped", parameters=wavy)
    [note] = resolve_evaluation(single, lambda _: bundle).notes
    off = np.abs(np.array(manifest.shapes["gain"].values(with_coefficients(wavy, manifest.shapes, ""))) - wavy["gain"]).max()
    assert {"parameters.gain:", f"{off:.3g}"} <= set(note.split())


def test_a_list_becomes_the_nearest_curve_of_a_narrowed_space() -> None:
    bundle = Bundle("d", "f", checked(document({"coefficients": 3}, {"coefficients": 4})))
    own = [{"name": "gain", "lower": 1, "upper": 2, "step": 0.25}]
    fixed = {"a": 0.5, "torque": [[7, 7, 7]] * 4}
    wanted = {"problem": "shaped", "parameters": own, "fixed": fixed, "baseline": fixed | {"gain": [1, 2, 1, 2, 1, 2]}}
    baseline = present(resolve(CampaignSpecification.model_validate(wanted), lambda _: bundle).baseline)
    assert all(baseline.floats[f"gain_{place}"] in (1, 1.25, 1.5, 1.75, 2) for place in (1, 2, 3))


@pytest.mark.parametrize("values", [[1, 1, 1, 1, 1, 9], [1, 1, 2, 1, 1, 1]])
def test_coefficients_take_no_list_beyond_the_range_or_against_the_course(values: list[float]) -> None:
    gain = checked(document({"coefficients": 3, "monotone": "decreasing"})).shapes["gain"]
    assert faults_of(gain.settings, values, "fixed.gain")[0].field == "fixed.gain"


def test_conditions_of_a_map_run_along_its_axes() -> None:
    entry = ShapeEntry.model_validate(TORQUE | {"coefficients": 4, "monotone": {"y": "increasing"}, "slope": {"x": 10}})
    listed = list(Shape.declared("torque", entry).conditions)
    assert listed == [
        "torque_2_1 - torque_1_1 <= 40",
        "torque_1_1 - torque_2_1 <= 40",
        "torque_2_2 - torque_1_2 <= 40",
        "torque_1_2 - torque_2_2 <= 40",
        "torque_1_1 <= torque_1_2",
        "torque_2_1 <= torque_2_2",
    ]


def test_a_curve_of_many_points_with_a_long_name_can_be_monotone() -> None:
    many = {"curve": {"axis": list(range(190))}, "lower": 0, "upper": 1, "monotone": "increasing"}
    manifest = checked(document({}, parameters={"g" * 60: many}))
    [constraints] = [Constraints(ParameterSpace(parameters_of(manifest)), constraints_of(manifest))]
    falls = np.arange(190)[::-1] * 10**6
    assert not constraints.feasible(falls[np.newaxis])[0]
    assert constraints.feasible(falls[np.newaxis, ::-1])[0]
    with pytest.raises(InvalidInputError) as refused:  # a coefficient's name is one of `parameters` in stored campaigns
        checked(document({}, parameters={"g" * 61: many}))
    assert [problem.field for problem in refused.value.problems] == ["parameters." + "g" * 61]


def test_a_coefficient_beside_its_list_is_refused() -> None:
    both = {"a": 0.5, "gain": [1] * 6, "torque": [[0, 0, 0]] * 4, "gain_2": 2}
    assert faulty_fields(checked, document({}, baseline=both)) == ["baseline.gain"]


def test_numbers_of_an_earlier_version_are_no_coefficients_of_a_curve_with_their_names() -> None:
    plain = {"a": {"lower": 0, "upper": 1}} | {f"gain_{number}": {"lower": 0.2, "upper": 3.2} for number in (1, 2, 3)}
    curve = {"a": plain["a"], "gain": GAIN | {"coefficients": 3}}
    for before, now in ((plain, curve), (curve, plain)):
        earlier = checked(document({}, parameters=before))
        present = checked(document({}, parameters=now | {"new": plain["a"]}, added={"new": 0}))
        assert earlier_version(present, earlier) is None

"""Manifests: every fault is named with its field and a remedy, all at once."""

import contextlib
import copy
import math
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.changes import with_change
from tests.support.effort import examples
from tests.support.values import faults_of

from drivecal.bundles.archives import BundleFile
from drivecal.bundles.checks import checked
from drivecal.bundles.fingerprints import score_id, setup_document
from drivecal.bundles.manifest import ScoreEntry
from drivecal.domain.errors import InvalidInputError
from drivecal.domain.scales import Direction

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples" / "problems"
VALID: dict[str, Any] = {
    "problem": "my-acc",
    "parameters": {
        "v0": {"lower": 20, "upper": 40, "step": 0.5, "unit": "m/s"},
        "T": {"lower": 0.8, "upper": 2.5},
        "n": {"lower": 1, "upper": 9, "integer": True},
        "mode": {"choices": ["eco", "sport"]},
    },
    "constraints": ["v0 >= 10*T", "mode != 'eco' or n <= 5"],
    "baseline": {"v0": 30, "T": 1.5, "n": 3, "mode": "eco"},
    "simulator": {"kind": "process", "command": ["./mysim", "--serve"], "probe": ["octave", "--version"]},
    "scenarios": {"city": {"any": "data", "gap": 30}, "motorway": {}},
    "measures": {"energy_kwh": "kWh", "min_ttc_s": "s"},
    "failures": ["collision"],
    "scores": {
        "cost": {
            "formula": "100*energy_kwh + 10/max(min_ttc_s, 0.1)",
            "direction": "minimise",
            "range": [0, 100],
            "tolerance": 2,
            "failed": 100,
        },
        "comfort": {"formula": "min_ttc_s", "direction": "maximise", "range": [0, 10]},
    },
}
FILES = {name: BundleFile(b"", name == "mysim") for name in ("mysim", "model.py", "data.csv", "system.fmu", "wheels/numpy.whl")}
COMMAND = {"kind": "command", "command": ["./mysim", "{parameters}", "{scenario}", "{results}"]}
PYTHON = {"kind": "python", "file": "model.py"}
FMU: dict[str, Any] = {
    "kind": "fmu",
    "file": "system.fmu",
    "duration": 20,
    "step": 0.1,
    "measures": {"energy_kwh": "last(E)", "min_ttc_s": "min(der(gap))"},
}


def document(**changes: Any) -> dict[str, Any]:
    """A valid manifest with the sections of `changes`."""
    return copy.deepcopy(VALID) | changes


def faults(given: object, files: dict[str, BundleFile] | None = None) -> set[str]:
    """Fields that are refused."""
    refusal = faults_of(checked, given, files)
    assert all(problem.message and problem.remedy for problem in refusal)
    return {problem.field for problem in refusal}


@pytest.mark.parametrize(("section", "slip"), [("measures", "mesures"), ("scores", "score"), ("scenarios", "scenario")])
def test_a_misspelt_section_is_not_missing_too(section: str, slip: str) -> None:
    given = document()
    given[slip] = given.pop(section)
    assert faults(given) == {slip}


def test_a_misspelt_field_of_a_kind_is_not_missing_too() -> None:
    assert faults(document(simulator={"kind": "python", "fil": "model.py"})) == {"simulator.fil"}


@pytest.mark.parametrize("simulator", [PYTHON, FMU], ids=lambda section: section["kind"])
def test_a_misspelt_field_of_the_simulator_is_compared_with_those_of_its_kind(simulator: dict[str, Any]) -> None:
    meant = {"python": "function", "fmu": "duration"}[simulator["kind"]]
    refusal = faults_of(checked, document(simulator=simulator | {f"{meant}s": 1}), FILES)
    assert [problem.remedy for problem in refusal if problem.field == f"simulator.{meant}s"] == [f"did you mean {meant}?"]


changed = partial(with_change, VALID)


@pytest.mark.parametrize(
    "simulator",
    [VALID["simulator"], COMMAND | {"command": [*COMMAND["command"], "{seed}"]}, PYTHON, PYTHON | {"wheels": "wheels"}, FMU],
)
def test_a_valid_manifest_of_each_kind_passes(simulator: dict[str, Any]) -> None:
    assert checked(document(simulator=simulator), FILES).problem == "my-acc"


@pytest.mark.parametrize("name", [path.parent.name for path in sorted(EXAMPLES.glob("*/problem.yaml"))])
def test_the_examples_pass_with_their_files(name: str) -> None:
    folder = EXAMPLES / name
    files = {path.name: BundleFile(b"", bool(path.stat().st_mode & 0o100)) for path in folder.iterdir()}
    files["acc"] = BundleFile(b"", executable=True)
    assert checked(yaml.safe_load((folder / "problem.yaml").read_text()), files).problem == name


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        ("problem", None, "problem"),
        ("problem", "highway", "problem"),
        ("problem", "a" * 64, "problem"),
        ("problem", "no name", "problem"),
        ("surplus", 1, "surplus"),
        ("parameters", {}, "parameters"),
        ("parameters", [], "parameters"),
        ("added", {"nothing": 1}, "added.nothing"),
        ("added", {"v0": 500}, "added.v0"),
        ("removed", {"v0": 20}, "removed.v0"),
        ("renamed", {"v0": "T"}, "renamed.v0"),
        ("renamed", {"v0": "old", "T": "old"}, "renamed.T"),
        ("parameters/v0/lower", None, "parameters.v0.lower"),
        ("parameters/v0/lower", 40, "parameters.v0.upper"),
        ("parameters/v0/step", 0.3, "parameters.v0.step"),
        ("parameters/v0/step", 1e-8, "parameters.v0.step"),
        ("parameters/v0/choices", ["a", "b"], "parameters.v0.choices"),
        ("parameters/T/lower", 0.12345678901, "parameters.T.lower"),
        ("parameters/n/lower", 1.5, "parameters.n.lower"),
        ("parameters/n/step", 2, "parameters.n.step"),
        ("parameters/mode/choices", ["eco", "eco"], "parameters.mode.choices"),
        ("parameters/mode/choices", ["eco", "\n"], "parameters.mode.choices[1]"),
        ("parameters/mode/integer", True, "parameters.mode.choices"),
        ("parameters/mode/choices", None, "parameters.mode.lower"),
        ("parameters/score", {"lower": 0, "upper": 1}, "baseline.score"),
        ("constraints/0", "v0 >= 10*S", "constraints[0]"),
        ("constraints/0", "v0 = T", "constraints[0]"),
        ("constraints/1", "mode == 'fast'", "constraints[1]"),
        ("constraints/0", "v0 <= 10*T", "baseline"),
        ("baseline/v0", None, "baseline.v0"),
        ("baseline/v1", 1, "baseline.v1"),
        ("baseline/v0", 50, "baseline.v0"),
        ("baseline/mode", "fast", "baseline.mode"),
        ("simulator/kind", "motorway", "simulator.kind"),
        ("simulator/kind", None, "simulator.kind"),
        ("simulator/command", [], "simulator.command"),
        ("simulator/command/0", "./sim", "simulator.command[0]"),
        ("simulator/command/0", "bin/sim", "simulator.command[0]"),
        ("simulator/command/0", "../mysim", "simulator.command[0]"),
        ("simulator/command/0", "mysim", "simulator.command[0]"),
        ("simulator/command/0", "./data.csv", "simulator.command[0]"),
        ("simulator/command/1", "./missing.csv", "simulator.command[1]"),
        ("simulator/probe", ["./missing"], "simulator.probe[0]"),
        ("simulator/memory_mb", 1, "simulator.memory_mb"),
        ("simulator", PYTHON | {"file": "/model.py"}, "simulator.file"),
        ("simulator", PYTHON | {"file": "a/../../model.py"}, "simulator.file"),
        ("simulator", PYTHON | {"file": "mode.py"}, "simulator.file"),
        ("simulator", PYTHON | {"file": "data.csv"}, "simulator.file"),
        ("simulator", PYTHON | {"wheels": "wheel"}, "simulator.wheels"),
        ("simulator", COMMAND | {"command": ["./mysim", "{results}"]}, "simulator.command"),
        ("simulator", COMMAND | {"timeout": "5 s"}, "simulator.timeout"),
        ("simulator", COMMAND | {"command": ["./mysim", "{parameters}", "{result}"]}, "simulator.command[2]"),
        ("simulator", FMU | {"step": 30}, "simulator.step"),
        ("simulator", FMU | {"measures": FMU["measures"] | {"E": "last(E)"}}, "simulator.measures.E"),
        ("simulator", FMU | {"measures": {"energy_kwh": "last(E)"}}, "measures.min_ttc_s"),
        ("simulator", FMU | {"measures": FMU["measures"] | {"min_ttc_s": "gap"}}, "simulator.measures.min_ttc_s"),
        ("scenarios", {}, "scenarios"),
        ("scenarios/city", 1, "scenarios.city"),
        ("measures", {}, "measures"),
        ("failures", ["crash"], "failures[0]"),
        ("failures", ["a", "a"], "failures[1]"),
        ("scores", {}, "scores"),
        ("scores/cost/formula", "energy", "scores.cost.formula"),
        ("scores/cost/formula", "import os", "scores.cost.formula"),
        ("scores/cost/range", [100, 0], "scores.cost.range"),
        ("varied", {"True": {"lower": 0, "upper": 1, "nominal": 0, "unit": "1"}}, "varied.True"),
        ("simulator/environment", ["A=B"], "simulator.environment[0]"),
        ("simulator/environment", ["MATLAB_HOME", "DRIVECAL_TOKEN"], "simulator.environment[1]"),
        ("simulator/environment", ["MATLAB_HOME", "PGPASSWORD"], "simulator.environment[1]"),
        ("simulator/environment", ["AWS_SECRET_ACCESS_KEY"], "simulator.environment[0]"),
        ("simulator/environment", ["AWS_ACCESS_KEY_ID"], "simulator.environment[0]"),
        ("simulator/environment", ["github_token"], "simulator.environment[0]"),
        ("simulator/environment", ["MATLAB_HOME", "HOME"], "simulator.environment[1]"),
        ("simulator/environment", ["TMPDIR"], "simulator.environment[0]"),
        ("simulator/environment", [f"N{number}" for number in range(51)], "simulator.environment"),
        ("scores/cost/failed", 99, "scores.cost.failed"),
        ("scores/comfort/failed", 1, "scores.comfort.failed"),
        ("scores/cost/tolerance", -1, "scores.cost.tolerance"),
    ],
)
def test_a_fault_is_named_by_its_field(path: str, value: Any, field: str) -> None:
    assert field in faults(changed(path, value), FILES)


@pytest.mark.parametrize("name", ["lambda", "in", "True"])
def test_a_name_that_cannot_stand_in_a_formula_is_refused(name: str) -> None:
    given = document(parameters={name: {"lower": 0, "upper": 1}}, constraints=[], baseline=None, measures={name: "m"})
    assert {f"parameters.{name}", f"measures.{name}"} <= faults(given)


def test_parameters_that_would_share_a_column_are_refused() -> None:
    parameters = {name: {"lower": 0, "upper": 1} for name in ("score", "parameter_score")}
    assert faults(document(parameters=parameters, constraints=[], baseline=None)) == {"parameters.parameter_score"}


def test_all_faults_of_all_sections_are_named_at_once() -> None:
    given = changed("scores/cost/formula", "energy + ttc")
    given["parameters"]["v0"]["step"] = 0.3
    given["simulator"] = {"kind": "python"}
    given["constraints"].append("x < 1")
    given["measures"]["min_ttc_s"] = 1
    given["failures"] = ["hang"]
    given["extra"] = 1
    wanted = {"parameters.v0.step", "simulator.file", "constraints[2]", "measures.min_ttc_s", "failures[0]", "extra"}
    assert faults(given) == wanted
    given["measures"]["min_ttc_s"] = "s"
    assert faults(given) == (wanted - {"measures.min_ttc_s"}) | {"scores.cost.formula"}


def test_a_formula_that_yaml_cut_at_a_comma_is_recognised() -> None:
    score = yaml.safe_load("{formula: max(energy_kwh, min_ttc_s), direction: maximise, range: [0, 1]}")
    [problem] = faults_of(checked, document(scores={"cost": score}))
    assert problem.field == "scores.cost.min_ttc_s)"
    assert "quotes" in problem.remedy


def test_files_are_not_looked_for_if_they_are_not_known() -> None:
    assert checked(changed("simulator/command/0", "./sim")).problem == "my-acc"


@pytest.mark.parametrize("given", [None, [], 1, "text", {}, {"scenarios": {"a": {"b": math.nan}}}])
def test_what_is_no_manifest_is_refused(given: object) -> None:
    with pytest.raises(InvalidInputError):
        checked(given)


FURTHER = "lower upper step choices kind command formula range a ./x ../x"
words = st.sampled_from([*VALID, *FURTHER.split(), "1 < a", ""])
values: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**9), 10**9) | st.floats(allow_nan=False, allow_infinity=False) | words,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(words, inner, max_size=3),
    max_leaves=8,
)


def paths(inner: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    children = inner.items() if isinstance(inner, dict) else enumerate(inner) if isinstance(inner, list) else ()
    return [path, *(deeper for key, child in children for deeper in paths(child, (*path, key)))]


@settings(deadline=None, max_examples=examples(200))
@given(path=st.sampled_from(paths(VALID)[1:]), value=values)
def test_whatever_stands_at_a_place_is_taken_or_refused(path: tuple[Any, ...], value: Any) -> None:
    given = document()
    inner: Any = given
    for part in path[:-1]:
        inner = inner[part]
    inner[path[-1]] = value
    with contextlib.suppress(InvalidInputError):
        assert checked(given, FILES).scores


def test_the_scale_of_a_score_fails_at_the_worst_end_by_default() -> None:
    manifest = checked(VALID)
    cost, comfort = (manifest.scores[name].scale(name) for name in ("cost", "comfort"))
    assert (cost.direction, cost.lower, cost.upper, cost.tolerance, cost.failed) == (Direction.MINIMISE, 0, 100, 2, 100)
    assert (comfort.failed, comfort.lower, comfort.upper) == (0, 0, 10)
    assert checked(changed("scores/cost/failed", None)).scores["cost"].scale("cost") == cost


def test_the_id_of_a_score_follows_what_changes_its_numbers() -> None:
    def identified(path: str, value: Any) -> str:
        return score_id("cost", checked(changed(f"scores/cost/{path}", value)).scores["cost"])

    same = score_id("cost", checked(VALID).scores["cost"])
    assert same.startswith("cost ")
    for path, value in (("tolerance", 5), ("unit", "EUR"), ("range", [50, 100]), ("failed", None)):
        assert identified(path, value) == same
    assert identified("formula", " 100*energy_kwh +10/max(min_ttc_s,0.1)") == same
    for path, value in (("formula", "energy_kwh"), ("failed", 101)):
        assert identified(path, value) != same
    comfort = ScoreEntry(evaluator="reference", direction="maximise", range=(0.0, 7.0))
    assert len({score_id("own", comfort.model_copy(update={"failed": worth})) for worth in (0.0, -50.0)}) == 2


def test_a_setup_follows_the_simulator_the_scenario_and_the_files_only(monkeypatch: pytest.MonkeyPatch) -> None:
    def setup(path: str, value: Any, files: str = "f") -> dict[str, Any]:
        return setup_document(checked(changed(path, value)), "city", files)

    same = setup_document(checked(VALID), "city", "f")
    for path, value in (
        ("simulator/timeout", 5),
        ("simulator/memory_mb", 500),
        ("simulator/deterministic", True),
        ("scores/cost/formula", "energy_kwh"),
        ("parameters/v0/upper", 60),
        ("parameters/mode/choices", ["sport", "eco", "normal"]),
        ("constraints", None),
        ("baseline", None),
        ("scenarios/motorway", {"gap": 1}),
    ):
        assert setup(path, value) == same
    for path, value in (
        ("simulator/command", ["./mysim"]),
        ("simulator/probe", None),
        ("scenarios/city/gap", 31),
        ("problem", "other"),  # the greeting of a process names it
    ):
        assert setup(path, value) != same
    assert setup("problem", "other", "g") != same
    monkeypatch.setattr("drivecal.bundles.fingerprints.VERSIONS", {"process": "of another adapter"})
    assert setup_document(checked(VALID), "city", "f") != same


def test_the_smallest_range_of_a_score_is_a_thousandth() -> None:
    """Scores count as equal to nine decimals, whatever their unit."""
    assert checked(changed("scores/comfort/range", [1, 1.001])).scores["comfort"].range == (1, 1.001)


def test_names_of_variables_are_part_of_a_setup_if_there_are_any() -> None:
    assert "environment" not in setup_document(checked(VALID), "city", "f")["simulator"]
    names = ["MATLAB_HOME", "TOOL_LICENSE_KEY", "KEYBOARD", "PGHOST"]
    named = checked(changed("simulator/environment", names))
    assert setup_document(named, "city", "f")["simulator"]["environment"] == names

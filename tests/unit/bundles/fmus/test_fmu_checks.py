"""Checks of problems against FMUs: inputs without a value, constants, directions of signals, units of parameters."""

import copy
import time
import tracemalloc
import zipfile
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.support.fmus import archive
from tests.support.values import faults_of
from tests.support.zips import zipped

from drivecal.bundles.archives import BundleFile, files_of, pack
from drivecal.bundles.checks import checked
from drivecal.bundles.fingerprints import setup_document
from drivecal.bundles.fmus import description as description_module
from drivecal.bundles.fmus.bundles import MOST_PROBLEMS, check_fmus, fields_of_resets
from drivecal.bundles.fmus.checks import unused_notes
from drivecal.bundles.fmus.description import FmuVariable, parse_description, read_fmu
from drivecal.configuration.problems import read_archived, read_bundle_with_notes

SECOND = """<fmiModelDescription fmiVersion="2.0" modelName="acc" guid="1"><CoSimulation modelIdentifier="acc"/>
<UnitDefinitions><Unit name="mps"><BaseUnit m="1" s="-1"/></Unit><Unit name="kmh"><BaseUnit m="1" s="-1" factor="0.27778"/></Unit>
</UnitDefinitions>
<TypeDefinitions><SimpleType name="Speed"><Real unit="km/h"/></SimpleType>
<SimpleType name="Mode"><Enumeration><Item name="eco" value="1"/><Item name="sport" value="2"/></Enumeration></SimpleType>
</TypeDefinitions>
<ModelVariables>
<ScalarVariable name="u1" valueReference="1" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="acc_enable" valueReference="2" causality="input"><Boolean start="false"/></ScalarVariable>
<ScalarVariable name="v_set" valueReference="3" causality="parameter"><Real start="0" declaredType="Speed"/></ScalarVariable>
<ScalarVariable name="T" valueReference="4" causality="parameter"><Real start="0" unit="s"/></ScalarVariable>
<ScalarVariable name="v_min" valueReference="5" causality="parameter"><Real start="0" unit="mps"/></ScalarVariable>
<ScalarVariable name="k" valueReference="6" causality="parameter"><Real start="0" unit="1"/></ScalarVariable>
<ScalarVariable name="n" valueReference="7" causality="parameter"><Integer start="0"/></ScalarVariable>
<ScalarVariable name="mode" valueReference="8" causality="parameter"><Enumeration declaredType="Mode" start="1"/></ScalarVariable>
<ScalarVariable name="label" valueReference="9" causality="parameter"><String start=""/></ScalarVariable>
<ScalarVariable name="y" valueReference="10" causality="output"><Real/></ScalarVariable>
<ScalarVariable name="x" valueReference="11"><Real/></ScalarVariable>
</ModelVariables></fmiModelDescription>"""
THIRD = """<fmiModelDescription fmiVersion="3.0" modelName="acc" instantiationToken="1"><CoSimulation modelIdentifier="acc"/>
<UnitDefinitions><Unit name="mps"><BaseUnit m="1" s="-1"/></Unit></UnitDefinitions>
<TypeDefinitions><Float64Type name="Speed" unit="km/h"/>
<EnumerationType name="Mode"><Item name="eco" value="1"/><Item name="sport" value="2"/></EnumerationType></TypeDefinitions>
<ModelVariables>
<Float64 name="u1" valueReference="1" causality="input" start="0"/>
<Boolean name="acc_enable" valueReference="2" causality="input" start="false"/>
<Float64 name="v_set" valueReference="3" causality="parameter" start="0" declaredType="Speed"/>
<Float64 name="T" valueReference="4" causality="parameter" start="0" unit="s"/>
<Float64 name="v_min" valueReference="5" causality="parameter" start="0" unit="mps"/>
<Float64 name="k" valueReference="6" causality="parameter" start="0" unit="1"/>
<Int8 name="n" valueReference="7" causality="parameter" start="0"/>
<Enumeration name="mode" valueReference="8" causality="parameter" declaredType="Mode" start="1"/>
<String name="label" valueReference="9" causality="parameter"><Start value=""/></String>
<Float64 name="y" valueReference="10" causality="output"/>
<Float64 name="x" valueReference="11"/>
</ModelVariables></fmiModelDescription>"""
SIGNALS = {"gap": "u1", "acceleration": "y"}
PROBLEM: dict[str, Any] = {
    "problem": "acc",
    "parameters": {"T": {"lower": 1, "upper": 2, "unit": "s"}},
    "simulator": {
        "kind": "highway",
        "controller": {
            "kind": "fmu",
            "file": "acc.fmu",
            "signals": SIGNALS,
            "constants": {"acc_enable": True},
            "output": ["acceleration"],
        },
    },
    "scenarios": {"S": {"network": "road.net.xml", "route": ["e1"], "duration": 10, "ego": {"s": 10, "speed": 20}}},
    "measures": {"energy_kwh": "kWh"},
    "scores": {"cost": {"formula": "energy_kwh", "direction": "minimise", "range": [0, 1]}},
}
SYSTEM = {"kind": "fmu", "file": "acc.fmu", "duration": 1, "step": 0.1, "measures": {"energy_kwh": "last(y)"}}


def file_of(description: str) -> BundleFile:
    return BundleFile(zipped(("modelDescription.xml", description)), False)


def problem(parameters: dict[str, str] | None = None, **controller: Any) -> dict[str, Any]:
    """The problem with other units of parameters, or other fields of the controller; None leaves a field out."""
    given = copy.deepcopy(PROBLEM)
    if parameters is not None:
        given["parameters"] = {name: {"lower": 1, "upper": 2, "unit": unit} for name, unit in parameters.items()}
    section = given["simulator"]["controller"] | controller
    given["simulator"]["controller"] = {name: value for name, value in section.items() if value is not None}
    return given


def notes(given: dict[str, Any], description: str) -> tuple[str, ...]:
    """All notes but the count of what is left out."""
    said = check_fmus(checked(given), {"acc.fmu": file_of(description)})
    return tuple(note for note in said if " leaves out " not in note)


def faults(given: dict[str, Any], description: str) -> dict[str, str]:
    """Fields of all faults, with their messages and remedies."""
    return {entry.field: f"{entry.message}; {entry.remedy}" for entry in faults_of(notes, given, description)}


both = pytest.mark.parametrize("description", [SECOND, THIRD], ids=["second", "third"])


@both
def test_an_input_that_nothing_gives_is_refused_by_name(description: str) -> None:
    named = faults(problem(constants=None), description)
    assert named.keys() == {"simulator.controller.constants"}
    assert "acc_enable" in named["simulator.controller.constants"]
    for given in (
        problem(),
        problem(constants=None, signals=SIGNALS | {"leader_exists": "acc_enable"}),
        problem(constants=None) | {"parameters": {"acc_enable": {"lower": 0, "upper": 1, "integer": True}}},
    ):
        assert notes(given, description) == ()


@both
@pytest.mark.parametrize(
    "constants",
    [
        {"acc_enable": True},
        {"acc_enable": 1},
        {"acc_enable": True, "T": 1.5, "n": 3, "mode": "sport", "label": "text"},
        {"acc_enable": False, "mode": 2},
        {"acc_enable": True, "T": 2.1e11, "v_set": -1e300, "n": 127, "label": "a" * 255},
    ],
)
def test_constants_that_fit_pass(description: str, constants: dict[str, Any]) -> None:
    assert notes(problem({"k": "1"}, constants=constants), description) == ()


@both
@pytest.mark.parametrize(
    ("name", "value", "wanted"),
    [
        ("acc_enabled", 1, "acc_enable"),
        ("acc_enable", 2, "true or false"),
        ("acc_enable", "true", "true or false"),
        ("k", "high", "a number"),
        ("k", True, "a number"),
        ("n", 1.5, "a whole number"),
        ("mode", "fast", "eco, sport"),
        ("label", 1, "a text"),
        ("y", 1, "the signal acceleration"),
        ("x", 1, "local"),
        ("u1", 1, "the signal gap"),
        ("T", 1, "the parameter"),
    ],
)
def test_constants_that_do_not_fit_are_refused_by_name(description: str, name: str, value: Any, wanted: str) -> None:
    named = faults(problem(constants={"acc_enable": True, name: value}), description)
    assert named.keys() == {f"simulator.controller.constants.{name}"}
    assert wanted in named[f"simulator.controller.constants.{name}"]


def test_constants_have_the_range_of_their_type() -> None:
    given = problem(constants={"acc_enable": True, "n": 2**31 - 1, "v_min": 1e300})
    assert notes(given, SECOND) == ()
    single = THIRD.replace('<Float64 name="v_min"', '<Float32 name="v_min"')
    assert faults(given, single).keys() == {f"simulator.controller.constants.{name}" for name in ("n", "v_min")}
    assert notes(problem(constants={"acc_enable": True, "v_min": 3.4e38}), single) == ()


@both
@pytest.mark.parametrize(
    ("name", "entry", "field"),
    [
        ("n", {"lower": -129, "upper": 5e9, "integer": True}, "upper"),
        ("n", {"lower": -1e10, "upper": 5, "integer": True}, "lower"),
        ("n", {"lower": 0, "upper": 5.5}, "upper"),
        ("n", {"lower": 0, "upper": 5, "step": 0.5}, "step"),
        ("n", {"lower": 0, "upper": 5}, "step"),
        ("mode", {"choices": ["eco", "race"]}, "choices[1]"),
        ("acc_enable", {"lower": 0, "upper": 2, "integer": True}, "upper"),
    ],
)
def test_parameters_beyond_their_type_are_refused(description: str, name: str, entry: dict[str, Any], field: str) -> None:
    given = problem(constants=None if name == "acc_enable" else {"acc_enable": True}) | {"parameters": {name: entry}}
    named = faults(given, description)
    assert f"parameters.{name}.{field}" in named
    assert all(key.startswith(f"parameters.{name}") for key in named)


@both
def test_start_values_that_their_variable_cannot_hold_are_refused(description: str) -> None:
    given = PROBLEM | {"simulator": SYSTEM, "scenarios": {"S": {"n": 2.0**63, "mode": "race", "T": 1.5}}}
    assert faults(given, description).keys() == {"scenarios.S.n", "scenarios.S.mode"}
    assert notes(PROBLEM | {"simulator": SYSTEM, "scenarios": {"S": {"n": 100, "mode": "eco"}}}, description) == ()


@both
@pytest.mark.parametrize(
    ("variability", "start", "is_taken"), [("fixed", "", False), ("fixed", "1", True), ("constant", "1", False)]
)
def test_a_parameter_that_the_fmu_computes_is_refused(description: str, variability: str, start: str, is_taken: bool) -> None:
    value = f' start="{start}"' * bool(start)
    second, third = (f'<{tag} name="x" valueReference="11"' for tag in ("ScalarVariable", "Float64"))
    named = description.replace(f"{second}><Real/>", f'{second} variability="{variability}"><Real{value}/>')
    named = named.replace(f"{third}/>", f'{third} variability="{variability}"{value}/>')
    given = PROBLEM | {"simulator": SYSTEM, "parameters": {"x": {"lower": 0, "upper": 1}}}
    assert notes(given, named) == () if is_taken else "parameters.x.lower" in faults(given, named)


@pytest.mark.parametrize("value", [1e301, float("inf"), "", "a" * 256, "two\nlines"])
def test_constants_beyond_all_types_are_refused(value: Any) -> None:
    assert all("acc_enable" in entry.field for entry in faults_of(checked, problem(constants={"acc_enable": value})))


@both
def test_signals_have_the_directions_of_their_variables(description: str) -> None:
    swapped = faults(problem(signals={"gap": "y", "acceleration": "u1"}), description)
    assert swapped.keys() == {"simulator.controller.signals.gap", "simulator.controller.signals.acceleration"}


@both
def test_parameters_have_the_units_of_their_variables(description: str) -> None:
    for simulator in (PROBLEM["simulator"], SYSTEM):
        right = problem({"v_set": "km/h", "T": "s", "v_min": "m.s^-1", "k": "m"}) | {"simulator": simulator}
        assert notes(right, description) == ()
        wrong = problem({"v_set": "m/s", "T": "ms", "v_min": "km/h"}) | {"simulator": simulator}
        named = faults(wrong, description)
        assert named.keys() == {f"parameters.{name}.unit" for name in ("v_set", "T", "v_min")}
        assert "km/h" in named["parameters.v_set.unit"]
        assert "m/s" in named["parameters.v_set.unit"]


@both
def test_measures_and_series_have_the_units_of_their_outputs(description: str) -> None:
    simulator = SYSTEM | {"measures": {"energy_kwh": "last(y)", "speed": "max(v_min)", "way": "integral( v_min )"}}
    given = PROBLEM | {"simulator": simulator, "series": {"v_min": "m/s"}}
    for units in ({"speed": "m/s", "way": "m"}, {"speed": "1", "way": "1"}):
        assert notes(given | {"measures": PROBLEM["measures"] | units}, description) == ()
    wrong = given | {"measures": PROBLEM["measures"] | {"speed": "km/h", "way": "m/s"}, "series": {"v_min": "km/h"}}
    assert faults(wrong, description).keys() == {"measures.speed", "measures.way", "series.v_min"}


@both
def test_a_parameter_without_a_unit_is_noted_with_that_of_the_fmu(description: str) -> None:
    noted = notes(problem({"v_set": "1", "T": "s", "k": "1"}), description)
    assert len(noted) == 1
    assert "v_set" in noted[0]
    assert "km/h" in noted[0]


@pytest.mark.parametrize("compression", [zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_an_fmu_that_cannot_be_read_is_left_to_the_worker(compression: int) -> None:
    whole = BytesIO()
    with zipfile.ZipFile(whole, "w", compression) as target:
        target.writestr("modelDescription.xml", SECOND)
    place = 30 + len("modelDescription.xml")
    damaged = [whole.getvalue()[:at] + b"\xff" * 20 + whole.getvalue()[at + 20 :] for at in range(place, place + 60, 3)]
    for content in (b"no archive", file_of("<a").content, *damaged):
        assert check_fmus(checked(problem()), {"acc.fmu": BundleFile(content, False)}) == ()


@pytest.mark.parametrize("compression", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_a_description_that_would_be_expanded_whole_is_refused_before(compression: int) -> None:
    """zipfile expands these methods without regard to how much is asked for."""
    whole = BytesIO()
    with zipfile.ZipFile(whole, "w", compression) as target:
        target.writestr("modelDescription.xml", bytes(40 << 20))
    assert len(whole.getvalue()) < 10_000
    tracemalloc.start()
    assert read_fmu(whole.getvalue()) is None
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 20


def test_an_fmu_with_too_many_files_is_refused_before_they_are_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = BytesIO()
    with zipfile.ZipFile(whole, "w") as target:
        target.writestr("modelDescription.xml", SECOND)
        for number in range(100):
            target.writestr(f"resources/{number}", b"")
        target.comment = b"made by a tool"
    assert read_fmu(whole.getvalue()) == parse_description(SECOND.encode())
    far = whole.getvalue()[:-16] + bytes(2) + bytes(1 << 16)  # as far from the end as zipfile looks
    assert description_module._directory_size(far) > 5_000
    monkeypatch.setattr(description_module, "LARGEST_DIRECTORY", 5_000)
    monkeypatch.setattr(zipfile, "ZipFile", lambda *_: pytest.fail("its files are listed"))
    assert read_fmu(whole.getvalue()) is None


def test_arrays_are_no_numbers() -> None:
    xml = THIRD.replace('causality="input" start="0"/>', 'causality="input"><Dimension start="3"/><Alias name="v"/></Float64>')
    assert [name for name, variable in (parse_description(xml.encode()) or {}).items() if variable.is_array] == ["u1", "v"]
    assert "simulator.controller.constants.u1" in faults(
        problem(signals={"acceleration": "y"}, constants={"acc_enable": True, "u1": 1}), xml
    )


@pytest.mark.parametrize(
    "given",
    [
        '<Float64 name="targets" valueReference="20" causality="input"><Dimension start="8"/></Float64>',
        '<Clock name="targets" valueReference="20" causality="input" intervalVariability="triggered"/>',
        '<Binary name="targets" valueReference="20" causality="input"><Start value=""/></Binary>',
    ],
    ids=["array", "clock", "binary"],
)
def test_an_input_that_nothing_can_give_is_noted(given: str) -> None:
    noted = notes(problem(), THIRD.replace("<ModelVariables>", f"<ModelVariables>{given}"))
    assert len(noted) == 1
    assert "targets" in noted[0]


def test_what_a_problem_leaves_out_of_an_fmu_is_counted() -> None:
    kinds = ["input", "input", "output", "parameter", "local", "parameter"]
    variables = {f"v{index}": FmuVariable(f"v{index}", kind) for index, kind in enumerate(kinds)}
    (note,) = unused_notes("simulator", {"v0", "v3"}, variables)
    assert "1 input, 1 output, 1 parameter of" in note
    given = PROBLEM | {"simulator": SYSTEM, "scenarios": {"S": {"n": 100}}}
    assert any(" leaves out " in note for note in check_fmus(checked(given), {"acc.fmu": file_of(SECOND)}))


def test_faults_have_their_lines_and_notes_come_with_the_bundle_and_an_archive_is_checked_as_a_folder_is(
    tmp_path: Path,
) -> None:
    archive(tmp_path / "acc.fmu", SECOND, {})
    (tmp_path / "problem.yaml").write_text(yaml.safe_dump(problem({"v_set": "1"}) | {"simulator": SYSTEM}))
    assert len([note for note in read_bundle_with_notes(tmp_path)[2] if " leaves out " not in note]) == 1
    (tmp_path / "problem.yaml").write_text(yaml.safe_dump(problem({"v_set": "m/s"}) | {"simulator": SYSTEM}))
    assert "line" in faults_of(read_bundle_with_notes, tmp_path)[0].field
    assert ["parameters.v_set.unit" in entry.field for entry in faults_of(read_archived, files_of(pack(tmp_path)))] == [True]


def test_an_fmu_of_a_stranger_is_checked_in_seconds() -> None:
    """A server checks what is pushed: a long unit, many items, many inputs."""
    unit = "m" + " " * 200_000 + "s"
    enumeration = '<EnumerationType name="Modes">' + '<Item name="i" value="1"/>' * 20_000 + "</EnumerationType>"
    inputs = "".join(
        f'<Enumeration name="i{index}" valueReference="{index}" causality="input" declaredType="Modes"/>'
        for index in range(20_000)
    )
    hostile = (
        THIRD.replace('unit="s"', f'unit="{unit}"')
        .replace("<EnumerationType", f"{enumeration}<EnumerationType", 1)
        .replace("<ModelVariables>", f"<ModelVariables>{inputs}")
    )
    start = time.process_time()
    assert len(faults_of(notes, problem(constants={f"a{index}": 1 for index in range(20)}), hostile)) == MOST_PROBLEMS
    assert time.process_time() - start < 20.0


def test_resets_and_constants_of_fmus_are_part_of_a_setup() -> None:

    def section(**fields: Any) -> Any:
        given = problem(constants=None)
        given["simulator"]["controller"] |= fields
        return setup_document(checked(given), "S", "f")["simulator"]["controller"]

    plain = section()
    assert section(reset=True) == plain
    assert "constants" not in plain
    assert section(reset=False) == plain | {"reset": False}
    assert section(constants={"a": 1}) == plain | {"constants": {"a": 1.0}}


@pytest.mark.parametrize(("reset", "renews"), [(None, False), (True, False), (False, True)])
def test_a_part_that_is_not_reset_renews_the_process(reset: bool | None, renews: bool) -> None:
    controller, system = (
        checked(given)
        for given in (problem(reset=reset), PROBLEM | {"simulator": SYSTEM | ({} if reset is None else {"reset": reset})})
    )
    assert (controller.simulator.renews, system.simulator.renews) == (renews, renews)
    assert fields_of_resets(controller) == ([] if renews else ["simulator.controller"])
    assert fields_of_resets(system) == ([] if renews else ["simulator"])

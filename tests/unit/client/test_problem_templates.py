"""New problems: each template is a bundle that runs, and an FMU's description is read with care."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples
from tests.support.values import faults_of, faulty_fields
from tests.support.zips import zipped

from drivecal.bundles.fmus.description import parse_description, read_fmu
from drivecal.bundles.installed import installed_problems
from drivecal.client.problem_templates import write_problem
from drivecal.configuration.problems import read_bundle
from drivecal.domain.errors import InvalidInputError
from drivecal.local.problems import CheckedScenario, run_problem, trial_set

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples" / "problems"
FMI2 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="m" guid="{1}">
  <CoSimulation modelIdentifier="m"/>
  <TypeDefinitions><SimpleType name="t"><Real unit="N"/></SimpleType></TypeDefinitions>
  <ModelVariables>
    <ScalarVariable name="k" valueReference="1" causality="parameter" variability="tunable" description="stiffness">
      <Real start="4" unit="N/m"/></ScalarVariable>
    <ScalarVariable name="der(x)" valueReference="7" causality="output"><Real unit="m/s"/></ScalarVariable>
    <ScalarVariable name="inner" valueReference="8"><Real/></ScalarVariable>
  </ModelVariables>
</fmiModelDescription>"""
LAUGHS = '<!DOCTYPE a [<!ENTITY b "ha"><!ENTITY c "&b;&b;">]><fmiModelDescription fmiVersion="2.0">&c;</fmiModelDescription>'


def answers(folder: Path) -> list[CheckedScenario]:
    """Runs the baseline in every scenario as a worker does."""
    manifest, archive = read_bundle(folder)
    results = list(run_problem(manifest, archive, trial_set(manifest)))
    assert [result.scenario for result in results] == list(manifest.scenarios)
    assert all(result.error is None and result.measures.keys() == manifest.measures.keys() for result in results)
    return results


def test_new_problems_are_valid_and_their_baselines_simulate_the_same(tmp_path: Path) -> None:
    results = []
    for kind in ("process", "command", "python"):
        written = write_problem(kind, "my-problem", tmp_path / kind)
        assert len(written) == 2
        manifest, _ = read_bundle(tmp_path / kind)
        assert (manifest.problem, manifest.simulator.kind) == ("my-problem", kind)
        assert "FOLDER" not in (tmp_path / kind / "problem.yaml").read_text()
        answered = answers(tmp_path / kind)
        for answer in answered:
            assert answer.scores.keys() == manifest.scores.keys(), kind
            assert all(0 < score < 100 for score in answer.scores.values()), kind
        results.append([(answer.scenario, answer.measures) for answer in answered])
    assert results[0] == results[1] == results[2]


def test_the_motorway_as_a_start_is_valid_and_has_another_name(tmp_path: Path) -> None:
    write_problem("highway-planner", "my-planner", tmp_path / "folder")
    manifest, _ = read_bundle(tmp_path / "folder")
    assert manifest.problem == "my-planner"
    assert manifest.has_planner
    motorway = installed_problems()["highway"].manifest
    assert (manifest.scenarios, manifest.scores, manifest.varied) == (motorway.scenarios, motorway.scores, motorway.varied)


def test_a_new_highway_problem_records_the_time_of_its_series(tmp_path: Path) -> None:
    write_problem("highway", "my-acc", tmp_path / "folder")
    assert read_bundle(tmp_path / "folder")[0].series["time_s"] == "s"


@pytest.mark.slow
def test_a_new_highway_problem_runs_on_a_motorway_of_its_own(tmp_path: Path) -> None:
    written = write_problem("highway", "my-acc", tmp_path / "folder")
    assert {file.name for file in written} == {"problem.yaml", "acc.py", "road.net.xml"}
    results = answers(tmp_path / "folder")
    assert len(results) == 2
    assert all(result.repeats and result.failure is None and 0 < result.scores["cost"] < 100 for result in results)


def test_the_shell_example_runs() -> None:
    assert answers(EXAMPLES / "command-shell")


def test_an_fmu_problem_without_an_fmu_says_what_to_put_where(tmp_path: Path) -> None:
    write_problem("fmu", "my-system", tmp_path / "folder")
    assert [problem.field.split(": ")[-1] for problem in faults_of(read_bundle, tmp_path / "folder")] == ["simulator.file"]


@pytest.mark.parametrize(
    "description",
    [
        FMI2.replace('"2.0"', '"1.0"'),
        FMI2.replace("CoSimulation", "ModelExchange"),
        FMI2[:-30],
        LAUGHS,
        LAUGHS.encode("utf-16"),
        "",
        "no XML",
        b"\xff\xfe\x00",
        "<a/>",
    ],
)
def test_an_fmu_that_cannot_be_used_has_no_variables(description: str | bytes) -> None:
    assert read_fmu(zipped(("modelDescription.xml", description))) is None
    assert read_fmu(zipped(("other.xml", FMI2))) is None


@settings(deadline=None, max_examples=examples(200))
@given(position=st.integers(0, len(FMI2) - 1), text=st.text(max_size=5))
def test_a_damaged_description_is_refused_or_read(position: int, text: str) -> None:
    damaged = (FMI2[:position] + text + FMI2[position + 1 :]).encode("utf-8", errors="surrogatepass")
    try:
        assert len(parse_description(damaged) or ()) <= 10
    except InvalidInputError as error:
        assert len(error.problems) == 1  # noqa: PT017  # both outcomes are right


@pytest.mark.parametrize(
    ("kind", "name", "field"),
    [("processes", "a", "kind"), ("python", "no name", "name"), ("python", "../a", "name"), ("python", "highway", "problem")],
)
def test_a_faulty_request_is_refused_before_anything_is_written(kind: str, name: str, field: str, tmp_path: Path) -> None:
    assert faulty_fields(write_problem, kind, name, tmp_path / "folder") == [field]
    assert not (tmp_path / "folder").exists()


def test_nothing_is_written_over(tmp_path: Path) -> None:
    write_problem("python", "a", tmp_path / "folder")
    with pytest.raises(InvalidInputError):
        write_problem("process", "a", tmp_path / "folder")

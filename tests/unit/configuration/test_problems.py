"""Reading bundles from disk: every fault is named with its line of problem.yaml."""

import shutil
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples
from tests.support.values import faults_of, faulty_fields

from drivecal.bundles.archives import BundleFile, content_digest, files_of, pack
from drivecal.configuration.problems import read_archived, read_bundle
from drivecal.domain.errors import InvalidInputError

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples" / "problems"
VALID = """\
problem: braking
parameters:
  v0: {lower: 20, upper: 40, step: 0.5}
  T:
    lower: 0.8
    upper: 2.5
constraints:
  - v0 >= 10*T
simulator: {kind: python, file: model.py}
scenarios:
  city: {gap: 30}
measures: {energy: kWh}
scores:
  cost:
    formula: 100*energy
    direction: minimise
    range: [0, 100]
"""


def files(content: bytes) -> dict[str, BundleFile]:
    return {name: BundleFile(text, executable=False) for name, text in (("problem.yaml", content), ("model.py", b""))}


def fields(content: str) -> list[str]:
    return faulty_fields(read_archived, files(content.encode()))


def test_a_folder_is_read_into_a_manifest_and_an_archive() -> None:
    manifest, archive = read_bundle(EXAMPLES / "python-function")
    assert manifest.problem == "python-function"
    assert set(files_of(archive)) == {"problem.yaml", "braking.py"}
    assert read_archived(files_of(archive))[0] == manifest
    assert read_bundle(EXAMPLES / "python-function")[1] == archive


def test_a_folder_in_another_place_has_the_same_digest(tmp_path: Path) -> None:
    shutil.copytree(EXAMPLES / "command-shell", tmp_path / "copy")
    assert content_digest(read_bundle(tmp_path / "copy")[1]) == content_digest(read_bundle(str(EXAMPLES / "command-shell"))[1])


@pytest.mark.parametrize(("ends", "is_refused"), [("\r\n", True), ("\n", False)])
def test_a_script_with_line_ends_of_windows_is_refused(tmp_path: Path, ends: str, is_refused: bool) -> None:
    section = 'simulator: {kind: command, command: [./run.sh, "{parameters}", "{results}"]}'
    (tmp_path / "problem.yaml").write_text(VALID.replace("simulator: {kind: python, file: model.py}", section))
    script = tmp_path / "run.sh"
    script.write_text("#!/bin/sh\ntrue\n", newline=ends)
    script.chmod(0o755)
    if not is_refused:
        assert read_bundle(tmp_path)[0].problem == "braking"
        return
    assert ["simulator.command[0]" in problem.field for problem in faults_of(read_bundle, tmp_path)] == [True]
    with pytest.raises(InvalidInputError):
        read_archived(files_of(pack(tmp_path)))


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("step: 0.5", "step: 0.3", ["problem.yaml: line 3: parameters.v0.step"]),
        ("    upper: 2.5\n", "", ["problem.yaml: line 4: parameters.T.upper"]),
        ("v0 >= 10*T", "v0 >= 10*S", ["problem.yaml: line 8: constraints[0]"]),
        ("100*energy", "100*energi", ["problem.yaml: line 15: scores.cost.formula"]),
        ("    direction: minimise\n", "", ["problem.yaml: line 14: scores.cost.direction"]),
        ("model.py", "mode.py", ["problem.yaml: line 9: simulator.file"]),
        ("problem: braking\n", "", ["problem.yaml: problem"]),
        ("problem: braking", "problem: braking\nproblem: twice", ["problem.yaml: line 2, column 1"]),
        ("gap: 30", "gap: .nan", ["problem.yaml: line 11, column 15"]),
        ("  city: {gap: 30}", "\tcity: 1", ["problem.yaml: line 11, column 1"]),
        (VALID, "", ["problem.yaml"]),
        (VALID, "- 1", ["problem.yaml"]),
    ],
)
def test_a_fault_is_named_with_its_line(old: str, new: str, expected: list[str]) -> None:
    assert fields(VALID.replace(old, new)) == expected


def test_all_faults_have_their_lines() -> None:
    given = VALID.replace("0.5", "0.3").replace("range: [0, 100]", "range: [0, -1]").replace("lower: 0.8", "lower: five")
    lines = {field.split(": ")[1] for field in fields(given)}
    assert lines == {"line 5", "line 17"}


def test_a_folder_without_a_manifest_is_refused(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "missing"):
        with pytest.raises(InvalidInputError):
            read_bundle(folder)


def test_a_very_large_manifest_is_refused() -> None:
    with pytest.raises(InvalidInputError):
        read_archived(files(VALID.encode() + b"#" * 2**20))


@settings(deadline=None, max_examples=examples(200))
@given(position=st.integers(0, len(VALID) - 1), text=st.text(max_size=5))
def test_a_damaged_manifest_is_refused_with_its_place_or_read(position: int, text: str) -> None:
    damaged = (VALID[:position] + text + VALID[position + 1 :]).encode("utf-8", errors="surrogatepass")
    try:
        read_archived(files(damaged))
    except InvalidInputError as error:
        places = [problem.field for problem in error.problems]
        assert all(place.startswith("problem.yaml") for place in places)  # several outcomes are right

"""Inputs outside of the folder are in the key of stored results, or `problem check` warns."""

import sys
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from drivecal.adapters.command import run_probe
from drivecal.adapters.inputs import digest_of_path
from drivecal.bundles.archives import pack
from drivecal.bundles.checks import checked
from drivecal.bundles.fingerprints import setup_document
from drivecal.bundles.installed import Bundle
from drivecal.domain.errors import InvalidInputError, UnavailableError
from drivecal.domain.setups import fingerprint_of
from drivecal.local.problems import ask_probe, run_problem, undeclared
from drivecal.runtime.bundles import OtherToolsError

MODEL = """
import os
from pathlib import Path
def evaluate(parameters, scenario):
    return {"y": parameters["x"] + float(os.environ.get("SIM_OFFSET", "0")) + float(Path(scenario["table"]).read_text())}
"""


def manifest_of(table: Path, **simulator: Any) -> dict[str, Any]:
    return {
        "problem": "offset",
        "parameters": {"x": {"lower": 0, "upper": 10, "step": 1}},
        "scenarios": {"s": {"table": str(table)}},
        "simulator": {"kind": "python", "file": "model.py", "deterministic": True, **simulator},
        "measures": {"y": "m"},
        "scores": {"y": {"formula": "y", "direction": "minimise", "range": [0, 100]}},
    }


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """A data file outside of the folder with the model."""
    folder = tmp_path / "problem"
    folder.mkdir()
    (folder / "model.py").write_text(MODEL)
    (folder / "problem.yaml").write_text("")
    file = tmp_path / "table.txt"
    file.write_text("7\n")
    return file


def key(document: dict[str, Any], folder: Path) -> str:
    """The run fingerprint with what this machine reports."""
    manifest = checked(document)
    archive = pack(folder)
    return fingerprint_of(setup_document(manifest, "s", "files", tools=ask_probe(manifest, archive)))


def test_a_folder_has_the_files_behind_its_links(tmp_path: Path) -> None:
    maps, elsewhere = tmp_path / "maps", tmp_path / "elsewhere"
    for folder in (maps / "v1", maps / "v2", elsewhere):
        folder.mkdir(parents=True)
        (folder / "road").write_text(folder.name)
    link = maps / "current"
    digests = []
    for target in (maps / "v1", maps / "v2", elsewhere, tmp_path):  # the last is a circle
        link.unlink(missing_ok=True)
        link.symlink_to(target)
        digests.append(digest_of_path(maps))
    (elsewhere / "road").write_text("changed")
    assert len({*digests, digest_of_path(maps)}) == 5


def test_a_folder_that_cannot_be_listed_has_no_digest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "maps").mkdir()
    monkeypatch.setattr("os.scandir", Mock(side_effect=PermissionError))
    with pytest.raises(PermissionError):
        digest_of_path(tmp_path / "maps")


@pytest.mark.slow
def test_values_of_variables_and_contents_of_inputs_are_in_the_key(table: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, program = table.parent / "problem", table.with_name("tool.py")
    program.write_text("print(1)")
    document = manifest_of(table, environment=["SIM_OFFSET"], inputs=[str(table), [sys.executable, str(program)]])
    keys = [key(document, folder), key(document, folder)]
    monkeypatch.setenv("SIM_OFFSET", "10")
    keys.append(key(document, folder))
    table.write_text("60\n")
    keys.append(key(document, folder))
    program.write_text("print(2)")
    keys.append(key(document, folder))
    assert keys[0] == keys[1]
    assert len(set(keys)) == 4
    answer = run_probe(checked(document).simulator.model_dump(mode="json"), folder)
    assert "10" not in answer.split(), "values are not shown"
    folder_of_inputs = manifest_of(table, inputs=[str(table.parent)])
    before = key(folder_of_inputs, folder)
    (table.parent / "another").write_text("")
    assert key(folder_of_inputs, folder) != before


def test_an_input_that_is_missing_refuses_the_machine(table: Path) -> None:
    section = checked(manifest_of(table, inputs=["/nowhere/table.txt"])).simulator.model_dump(mode="json")
    with pytest.raises(UnavailableError, match=r"/nowhere/table\.txt"):
        run_probe(section, table.parent / "problem")


def test_a_problem_without_inputs_asks_no_worker(table: Path) -> None:
    manifest = checked(manifest_of(table))
    assert not manifest.simulator.asks_workers
    assert ask_probe(manifest, b"") is None
    assert Bundle("", "", manifest).tools is None
    with pytest.raises(InvalidInputError, match=r"simulator\.inputs"):
        checked(manifest_of(table, inputs=["table.txt"]))


@pytest.mark.parametrize("declared", ["table.txt", "link/table.txt", None])
def test_a_check_warns_of_opened_files_that_are_not_declared(table: Path, declared: str | None) -> None:
    (table.parent / "link").symlink_to(table.parent)
    manifest = checked(manifest_of(table, inputs=[str(table.parent / declared)] if declared else None))
    results = list(run_problem(manifest, pack(table.parent / "problem"), {"x": 5}))
    assert results[0].measures == {"y": 12.0}
    assert [str(table) in warning for warning in undeclared(manifest, results)] == ([] if declared else [True])


def test_files_that_a_process_holds_open_are_seen(table: Path) -> None:
    program = table.parent / "problem" / "sim.py"
    program.write_text(
        f"import json\nfile = open({str(table)!r})\ninput()\nprint(json.dumps({{'ready': True}}), flush=True)\n"
        "while 'id' in (request := json.loads(input())):\n"
        "    print(json.dumps({'id': request['id'], 'measures': {'y': 1.0}}), flush=True)\n"
    )
    document = manifest_of(table) | {"simulator": {"kind": "process", "command": [sys.executable, "sim.py"]}}
    manifest = checked(document)
    results = list(run_problem(manifest, pack(table.parent / "problem"), {"x": 5}))
    assert len([warning for warning in undeclared(manifest, results) if str(table) in warning]) == 1


def test_a_worker_with_other_inputs_names_what_differs() -> None:
    error = OtherToolsError("2.0\n$A: 12\n/x: 34", "2.0\n$A: 12\n/x: 56")
    assert "/x: 34" in str(error)
    assert "/x: 56" in str(error)
    assert "2.0" not in str(error)

"""Probes of bundles: commands that print the version of tools outside of the bundle."""

from pathlib import Path
from typing import Any

import pytest
from tests.support.simulators import PYTHON, running, write_script

from drivecal.adapters import command
from drivecal.adapters.command import run_probe
from drivecal.domain.errors import UnavailableError


def section(*command: str) -> dict[str, Any]:
    return {"probe": list(command), "memory_mb": 500}


def python(code: str) -> dict[str, Any]:
    return section(PYTHON, "-S", "-c", code)


@pytest.mark.parametrize(
    ("code", "answer"),
    [
        ("print('mysim 2.1  '); print('build 7\\n')", "mysim 2.1\nbuild 7"),
        ("import sys; print('warming up', file=sys.stderr); print('2.1')", "2.1"),
        ("import sys; print('2.1', file=sys.stderr)", "2.1"),
    ],
)
def test_the_answer_is_what_it_prints(tmp_path: Path, code: str, answer: str) -> None:
    assert run_probe(python(code), tmp_path) == answer


def test_a_program_of_the_bundle_is_found(tmp_path: Path) -> None:
    write_script(tmp_path / "version", "#!/bin/sh\ncat number\n")
    (tmp_path / "number").write_text("3\n")
    assert run_probe(section("./version"), tmp_path) == "3"


@pytest.mark.parametrize(
    ("code", "cause"),
    [
        ("pass", "prints nothing"),
        ("import sys; print('2.1'); sys.exit('no licence')", "no licence"),
        ("print('x' * 4001)", "more than 4,000"),
        ("while True: print('x' * 60_000)", "more than 4,000"),
        ("bytearray(2_000_000_000)", "MemoryError"),
    ],
)
def test_a_probe_without_an_answer_refuses_the_machine(tmp_path: Path, code: str, cause: str) -> None:
    with pytest.raises(UnavailableError, match=cause):
        run_probe(python(code), tmp_path)


def test_a_tool_that_is_not_there_refuses_the_machine(tmp_path: Path) -> None:
    with pytest.raises(UnavailableError, match="nosuchtool"):
        run_probe(section("nosuchtool", "--version"), tmp_path)


def test_a_hanging_probe_ends_with_its_descendants(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "PROBE_SECONDS", 1.0)
    mark = f"hanging-{tmp_path.name}"
    code = f"import subprocess, time; print('2.1', flush=True); subprocess.Popen(['sleep', '600', '{mark}']); time.sleep(600)"
    with pytest.raises(UnavailableError, match="1 s"):
        run_probe(python(code), tmp_path)
    assert not running(mark)

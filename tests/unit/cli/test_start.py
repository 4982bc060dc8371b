"""Imports at the start of the command line."""

import subprocess
import sys
from pathlib import Path

import pytest
import typer

from drivecal.cli.__main__ import app
from drivecal.cli.application import COMMANDS

HEAVY = (
    *("numpy", "scipy", "ray", "sqlalchemy", "alembic", "fastapi", "pyarrow", "pandas", "sklearn", "numba", "drivecal.bundles"),
)
PRINTED = """
import sys
from drivecal.cli.__main__ import app
try:
    app(sys.argv[1:])
finally:
    print("imported:", *sys.modules)
"""


def imported(*arguments: str) -> set[str]:
    """The modules that a command has imported at its end, and the first parts of their names."""
    done = subprocess.run([sys.executable, "-c", PRINTED, *arguments], capture_output=True, text=True, check=False)
    modules = done.stdout.rpartition("imported:")[2].split()
    assert len(modules) > 100, done
    return {".".join(module.split(".")[:parts]) for module in modules for parts in (1, 2)}


@pytest.mark.parametrize(
    ("arguments", "more"),
    [(("--help",), ("httpx", "pydantic", "yaml")), (("list", "--url", "http://127.0.0.1:9"), ())],
    ids=["help", "list"],
)
def test_the_command_line_starts_without_heavy_modules(arguments: tuple[str, ...], more: tuple[str, ...]) -> None:
    assert not imported(*arguments) & {*HEAVY, *more}


def test_every_command_is_listed_with_the_beginning_of_its_help() -> None:
    group = typer.main.get_command(app)
    assert isinstance(group, typer.core.TyperGroup)
    for name, (_, summary) in COMMANDS.items():
        command = group.get_command(typer.Context(group), name)
        assert command is not None, name
        assert (command.help or "").replace("\n", " ").split()[:2] == summary.split()[:2]
    assert set(group.commands) == set(COMMANDS)


def test_output_that_cannot_be_written_is_told_in_a_line(tmp_path: Path) -> None:
    (tmp_path / "set.dcm").write_text("KONSERVIERUNG_FORMAT 2.0\nFESTWERT x\n WERT 1\nEND\n")
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-m", "drivecal.cli", "parameters", str(tmp_path / "set.dcm")]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, "Traceback" in done.stderr, "No space left" in done.stderr) == (1, False, True), done.stderr

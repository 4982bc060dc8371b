"""Files that `drivecal export -o -` writes to standard output hold names and messages of other people."""

import io
import os

import pytest
from typer.testing import CliRunner

from drivecal.cli.commands.results import _print
from drivecal.cli.main import app

NAME = "a\x1b]0;owned\x07\x9b31m\u202egnp.exe\u00e9,1\r\n"
ENCODED = NAME.encode()


def test_a_terminal_gets_nothing_that_it_would_obey() -> None:
    terminal, side = os.openpty()
    with os.fdopen(side, "w") as stream:
        _print(iter(ENCODED[index : index + 1] for index in range(len(ENCODED))), stream)
        shown = os.read(terminal, 1000).decode()
    os.close(terminal)
    assert shown.rstrip() == "a\ufffd]0;owned\ufffd\ufffd31m\ufffdgnp.exe\u00e9,1"


def test_a_pipe_gets_the_file_as_it_is() -> None:
    stream = io.TextIOWrapper(io.BytesIO())
    _print(iter([ENCODED]), stream)
    stream.seek(0)
    assert stream.buffer.read() == ENCODED


@pytest.mark.parametrize("option", ["--table=front", "--format=csv", "--row=1", "--where=score>=1", "--score=ease", "--json"])
def test_options_that_mlflow_would_ignore_are_refused_by_name(option: str) -> None:
    given = ["export", "id", "--to", "mlflow", "-o", "runs", "--url", "http://127.0.0.1:9"]
    refused = CliRunner().invoke(app, [*given, option])
    assert refused.exit_code == 2
    assert option.partition("=")[0] in refused.output

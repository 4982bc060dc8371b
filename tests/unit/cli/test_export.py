"""Files that `drivecal export -o -` writes to standard output hold names and messages of other people."""

import io
import os

from drivecal.cli.commands.results import _print

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

"""The command line in this process, and the log, which belongs to the whole process."""

import logging
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import structlog
from tests.support.serve import environment
from typer.testing import CliRunner, Result

from drivecal.cli.__main__ import app

Run = Callable[..., Result]
"""From the arguments of a command, and its standard input as `stdin`, to its result."""


def command(*arguments: str, stdin: str | None = None) -> Result:
    """Runs `drivecal` with these arguments."""
    return CliRunner().invoke(app, list(arguments), input=stdin)


def refused(folder: Path, *arguments: str, **settings: str) -> tuple[int, str]:
    """Exit code and words of a `serve` that is expected not to start. `settings` go into its environment."""
    with log_left_as_it_was():
        done = CliRunner().invoke(app, ["serve", *arguments], env=environment(folder) | settings)
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return done.exit_code, done.stderr


@contextmanager
def log_left_as_it_was() -> Iterator[None]:
    """Takes back everything that `drivecal.configuration.logs.configure` changes."""
    root, hooks = logging.getLogger(), (sys.excepthook, threading.excepthook)
    before = root.handlers, root.level
    levels = {name: logging.getLogger(name).level for name in ("drivecal", "__main__")}
    try:
        yield
    finally:
        root.handlers, root.level = before
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)
        sys.excepthook, threading.excepthook = hooks
        logging.captureWarnings(capture=False)
        structlog.reset_defaults()
        structlog.contextvars.clear_contextvars()

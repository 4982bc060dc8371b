"""The command line in this process."""

from collections.abc import Callable
from pathlib import Path

from tests.support.logs import log_left_as_it_was
from tests.support.serve import environment
from typer.testing import CliRunner, Result

from drivecal.cli.main import app

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

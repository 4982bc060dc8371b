"""The command line in this process."""

from __future__ import annotations

from collections.abc import Callable

from typer.testing import CliRunner, Result

from drivecal.cli.main import app

Run = Callable[..., Result]
"""From the arguments of a command, and its standard input as `stdin`, to its result."""


def command(*arguments: str, stdin: str | None = None) -> Result:
    """Runs `drivecal` with these arguments."""
    return CliRunner().invoke(app, list(arguments), input=stdin)

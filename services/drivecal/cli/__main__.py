"""The command line, `drivecal` and `python -m drivecal.cli`: commands are imported when they are called."""

import gc
import io
import sys
from importlib.metadata import version
from typing import Annotated

import typer

from drivecal.cli.application import app

__all__ = ["app", "main"]


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"drivecal {version('drivecal')}")
        raise typer.Exit


@app.callback()
def root(
    *,
    _version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Calibrates the parameters of automated driving functions in simulation and simulates only what can change the answer."""


def main() -> None:
    """Runs the command line. Text that the console cannot show is escaped; files and pipes get UTF-8."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace", encoding=None if stream.isatty() else "utf-8")
    gc.set_threshold(50_000)  # imports make many objects and no garbage: looking for it would take a sixth of a start
    app()


if __name__ == "__main__":
    main()

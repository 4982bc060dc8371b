"""The command line's entry point: all commands in one application."""

from __future__ import annotations

from importlib.metadata import version
from typing import Annotated

import typer

from drivecal.cli import (
    campaigns,
    comparing,
    evaluations,
    explain,
    influence,
    influence_maps,
    maintenance,
    report,
    results,
    robustness,
    serve,
    validation,
    workers,
)
from drivecal.cli.commands import app
from drivecal.cli.demo import command as demo

__all__ = [
    "app",
    "campaigns",
    "comparing",
    "demo",
    "evaluations",
    "explain",
    "influence",
    "influence_maps",
    "main",
    "maintenance",
    "report",
    "results",
    "robustness",
    "serve",
    "validation",
    "workers",
]


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
    """Runs the command line."""
    app()

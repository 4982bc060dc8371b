"""`drivecal results`: results of vehicles, test benches and other tools."""

import warnings
from pathlib import Path
from typing import Annotated

import typer

from drivecal.cli.application import app, say
from drivecal.cli.views.output import Asked, asking, parameters_text, print_columns
from drivecal.client.client import Client
from drivecal.domain.errors import NotFoundError

results = typer.Typer(no_args_is_help=True, help="Results of vehicles, test benches and tools, compared with simulations.")
app.add_typer(results, name="results")

ProblemArgument = Annotated[str, typer.Argument(metavar="PROBLEM", help="Name of the problem.")]


@results.command(name="import")
@asking
def import_(
    client: Client,
    file: Annotated[str, typer.Argument(metavar="FILE", help="CSV, Parquet or JSON: scenario, parameters, scores, measures.")],
    problem: Annotated[str, typer.Option(help="Name of the problem.")],
    source: Annotated[str, typer.Option(help="Name of the vehicle, test bench or tool.")],
    date: Annotated[str, typer.Option(metavar="YYYY-MM-DD", help="Day of the results.")],
) -> Asked:
    """Store results from elsewhere. No campaign takes one in place of a simulation."""
    from drivecal.client.imported import read_results

    known = client.problem(problem)
    rows, units = read_results(Path(file), known)
    warnings.showwarning = lambda message, *_: say(f"note: {message}")
    stored = client.import_results(rows, problem=known.name, source=source, date=date, units=units)
    text = f"{stored:,} of {len(rows):,} cells are new; compare them: drivecal results list {known.name}"
    return {"stored": stored, "known": len(rows) - stored}, lambda: say(text)


@results.command(name="list")
@asking
def list_(
    client: Client, problem: ProblemArgument, source: Annotated[str | None, typer.Option(help="Only this source.")] = None
) -> Asked:
    """List results from elsewhere, the stored simulations of the same sets, and the differences."""
    rows = client.imported(problem, source)

    def show() -> None:
        shapes = client.problem(problem).shapes
        header = ["source", "date", "scenario", "name", "value", "simulated", "difference", "unit", "parameters"]
        lines: list[list[object]] = []
        for row in rows:  # a set of an earlier push may lack coefficients
            whole = {name: shape for name, shape in shapes.items() if row.parameters.keys() >= {*shape.names}}
            text = parameters_text(row.parameters, shapes=whole)
            lines.append([text if name == "parameters" else getattr(row, name) for name in header])
        print_columns(header, lines)

    return rows, show


@results.command()
@asking
def delete(
    client: Client,
    problem: ProblemArgument,
    source: Annotated[str, typer.Argument(metavar="SOURCE", help="Name of the vehicle, test bench or tool.")],
) -> Asked:
    """Delete the results of a source."""
    deleted = client.delete_imported(client.problem(problem).name, source)
    if not deleted:
        raise NotFoundError("source", source, f"`drivecal results list {problem}` shows those with results")
    return {"deleted": deleted}, lambda: say(f"{deleted:,} cells are deleted")

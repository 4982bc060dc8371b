"""Fronts and trade-offs on stdout."""

from collections.abc import Sequence

import typer

from drivecal.cli.views.output import print_columns
from drivecal.contracts.assignments import value_text
from drivecal.contracts.results import FrontSummary, TradeOff, ValuePair
from drivecal.contracts.tables import FrontRow


def print_front(rows: Sequence[FrontRow], summary: FrontSummary) -> None:
    """Prints the sets of a front under what is known of the whole."""
    for objective in summary.objectives:
        unit = "" if objective.unit == "1" else f" {objective.unit}"
        ends = "" if objective.best is None else f", {objective.best:g} to {objective.worst:g}{unit} on the front"
        typer.echo(f"{objective.direction} {objective.name} ({objective.aggregate}){ends}")
    for constraint in summary.constraints:
        typer.echo(f"subject to {constraint}")
    volume = "" if summary.hypervolume is None else f"; hypervolume {summary.hypervolume:g}"
    typer.echo(f"{summary.evaluated:,} sets evaluated, {summary.feasible:,} feasible, {summary.size:,} on the front{volume}")
    if not rows:
        return
    first = rows[0]
    weighted = ["weighted"] if first.weighted is not None else []
    typer.echo()
    print_columns(
        ["rank", *first.objectives, *weighted, "wins", "sets", "", *first.parameters],
        [
            [
                row.rank,
                *(f"{amount:.6g}" for amount in row.objectives.values()),
                *([] if row.weighted is None else [f"{row.weighted:.4f}"]),
                None if row.wins is None else f"{row.wins:.1%}",
                row.alternatives,
                _marks(row),
                *row.parameters.values(),
            ]
            for row in rows
        ],
    )
    if any(row.reused for row in rows):
        typer.echo("* has a score of a reference")


def print_trade_off(answer: TradeOff) -> None:
    """Prints what the second of two sets gains and costs."""
    for line in answer.text:
        typer.echo(line)
    typer.echo(f"{len(answer.parameters)} parameters differ, by {answer.distance:.3f} of their ranges (root mean square)")
    typer.echo()
    listed = [*answer.scores, *answer.parameters]
    print_columns(["", f"rank {answer.first}", f"rank {answer.second}"], [_values(each) for each in listed])


def _values(difference: ValuePair) -> list[str]:
    values = (difference.first, difference.second)
    return [difference.name, *("-" if value is None else value_text(value) for value in values)]


def _marks(row: FrontRow) -> str:
    marks = [*(["knee"] if row.knee else []), *(f"best {name}" for name in row.best_in), *(["*"] if row.reused else [])]
    if row.violation > 0:
        marks.append(f"breaks constraints by {row.violation:.3g}")
    return ", ".join(marks)

"""Fronts and trade-offs on stdout."""

from collections.abc import Sequence

import typer

from drivecal.cli.application import tell
from drivecal.cli.views.output import print_columns
from drivecal.contracts.assignments import value_text
from drivecal.contracts.results import FrontSummary, TradeOff, ValuePair
from drivecal.contracts.tables import FrontRow
from drivecal.report.rows import front_lines, front_marks, left_out_of_front, shown_of_front


def print_front(rows: Sequence[FrontRow], summary: FrontSummary, limit: int) -> None:
    """Prints sets of a front, knee and extremes among them, under what is known of the whole."""
    for line in front_lines(summary):
        typer.echo(line)
    if not rows:
        return
    first, kept = rows[0], shown_of_front(rows, limit)
    weighted = ["weighted"] if first.weighted is not None else []
    typer.echo()
    print_columns(
        ["rank", *first.objectives, *weighted, *first.constraints, "wins", "sets", "", *first.parameters],
        [
            [
                row.rank,
                *(f"{amount:.6g}" for amount in row.objectives.values()),
                *([] if row.weighted is None else [f"{row.weighted:.4f}"]),
                *(f"{amount:.6g}" for amount in row.constraints.values()),
                None if row.wins is None else f"{row.wins:.1%}",
                row.alternatives,
                front_marks(row),
                *row.parameters.values(),
            ]
            for row in kept
        ],
    )
    if any(row.reused for row in kept):
        typer.echo("* has a score of a reference")
    if len(kept) < len(rows):
        tell(f"{left_out_of_front(kept, rows)}; --limit {len(rows)} prints all")


def print_trade_off(answer: TradeOff) -> None:
    """Prints what the second of two sets gains and costs."""
    for line in answer.text:
        typer.echo(line)
    typer.echo(f"{len(answer.parameters)} parameters differ, by {answer.distance:.3f} of their ranges (root mean square)")
    typer.echo()
    listed = [*answer.constraints, *answer.scores, *answer.values, *answer.parameters]
    print_columns(["", f"rank {answer.first}", f"rank {answer.second}"], [_values(each) for each in listed])


def _values(difference: ValuePair) -> list[str]:
    values = (difference.first, difference.second)
    return [difference.name, *("-" if value is None else value_text(value) for value in values)]

"""The front of a campaign on the terminal. Pure."""

from collections.abc import Sequence

from drivecal.cli.views.sections import Block, Table, broken_text, percent
from drivecal.contracts.results import FrontBaseline, FrontSummary
from drivecal.contracts.tables import FrontRow
from drivecal.domain.scales import unit_text

SHOWN = 20
"""Sets that a page shows, if no more are marked."""


def front_blocks(rows: Sequence[FrontRow], summary: FrontSummary, limit: int = SHOWN) -> list[Block]:
    """Returns what is known of a whole front, and `limit` of its sets, if no more are marked."""
    lines = [f"  {line}" for line in front_lines(summary)]
    if not rows:
        return [*lines]
    kept = shown_of_front(rows, limit)
    caption = "The front: no other set is better in one objective without being worse in another"
    if len(kept) < len(rows):
        caption += f"; {len(kept):,} of {len(rows):,} sets: the knee, the best of each objective, and the first others"
    if any(row.reused for row in kept):
        caption += ". *: a score is that of a reference"
    first = rows[0]
    weighted = ["weighted"] if first.weighted is not None else []
    seeds = ["seeds"] if any(row.replicates > 1 for row in kept) else []
    header = ["rank", *first.objectives, *weighted, *first.constraints, "wins", "sets", *seeds, "robust", "", *first.parameters]
    cells = [
        [
            row.rank,
            *(f"{amount:.6g}{_interval(row, name)}" for name, amount in row.objectives.items()),
            *(f"{row.weighted:.4f}" for _ in weighted),
            *(f"{amount:.6g}" for amount in row.constraints.values()),
            *(percent(row.wins, 1), row.alternatives, *(row.replicates for _ in seeds), row.degree),
            front_marks(row),
            *row.parameters.values(),
        ]
        for row in kept
    ]
    return [*lines, Table(header, cells, caption)]


def front_lines(summary: FrontSummary) -> list[str]:
    """Returns what is known of a whole front: a line for each objective and constraint, for the baseline, and the numbers of sets."""
    lines = []
    for objective in summary.objectives:
        ends = (
            ""
            if objective.best is None
            else f", {objective.best:g} to {objective.worst:g}{unit_text(objective.unit)} on the front"
        )
        lines.append(f"{objective.direction} {objective.name} ({objective.aggregate}){ends}")
    lines += [f"subject to {constraint}" for constraint in summary.constraints]
    lines += [_baseline_line(summary, summary.baseline)] if summary.baseline is not None else []
    close = f", {summary.close:,} more cannot be told from these" if summary.close else ""
    lines.append(f"{summary.evaluated:,} sets evaluated, {summary.feasible:,} feasible, {summary.size:,} on the front{close}")
    return lines


def _interval(row: FrontRow, name: str) -> str:
    ends = [f"{row.uncertainty[f'{name}_{end}']:.4g}" for end in ("lower", "upper") if row.uncertainty]
    return f" ({' to '.join(ends)})" if ends else ""


def _baseline_line(summary: FrontSummary, baseline: FrontBaseline) -> str:
    units = {objective.name: unit_text(objective.unit) for objective in summary.objectives}
    amounts = ", ".join(f"{name} {amount:.6g}{units[name]}" for name, amount in baseline.objectives.items())
    broken = f"; {broken_text(baseline)}" if baseline.violation > 0 else ""
    place = "sets of the front beat it" if baseline.rank is None else f"on the front, rank {baseline.rank}"
    return f"baseline: {amounts} ({place}){broken}"


def shown_of_front(rows: Sequence[FrontRow], limit: int) -> list[FrontRow]:
    """Returns the first sets of a front, `limit` in all; knee and best of each objective are kept even beyond the limit."""
    room = limit - sum(row.knee or bool(row.best_in) for row in rows)
    others = [row.rank for row in rows if not (row.knee or row.best_in)][: max(0, room)]
    return [row for row in rows if row.knee or row.best_in or row.rank in others]


def front_marks(row: FrontRow) -> str:
    """Returns what is special about a set of a front; a star: it has a score of a reference."""
    marks = [*(["knee"] if row.knee else []), *(f"best {name}" for name in row.best_in), *(["*"] if row.reused else [])]
    if row.violation > 0:
        marks.append(broken_text(row))
    return ", ".join(marks)

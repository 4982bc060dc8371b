"""The front of a campaign on the terminal. Pure."""

from collections.abc import Sequence

import numpy as np

from drivecal.cli.views.sections import Block, Table, percent
from drivecal.contracts.results import FrontBaseline, FrontSummary
from drivecal.contracts.tables import FrontRow
from drivecal.domain.scales import unit_text

SHOWN = 20
"""Sets that a page shows, if no more are marked."""
OFTEN = 0.03
"""Share of all weightings from which on a set of a front wins often."""


def front_blocks(rows: Sequence[FrontRow], summary: FrontSummary, limit: int = SHOWN) -> list[Block]:
    """Returns what is known of a whole front, and `limit` of its sets, if no more are marked."""
    lines = [f"  {line}" for line in front_lines(summary)]
    if not rows:
        return [*lines]
    kept = shown_of_front(rows, limit)
    caption = "The front: no other set is better in one objective without being worse in another"
    caption += f"; {left_out}" if (left_out := left_out_of_front(kept, rows)) else ""
    if any(row.reused for row in kept):
        caption += ". *: a score is that of a reference"
    first = rows[0]
    weighted = ["weighted"] if first.weighted is not None else []
    header = ["rank", *first.objectives, *weighted, *first.constraints, "wins", "sets", "robust", "", *first.parameters]
    cells = [
        [
            row.rank,
            *(f"{amount:.6g}" for amount in row.objectives.values()),
            *(f"{row.weighted:.4f}" for _ in weighted),
            *(f"{amount:.6g}" for amount in row.constraints.values()),
            *(percent(row.wins, 1), row.alternatives, row.degree),
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
    corner = ", ".join(f"{goal.name} {goal.reference:.6g}" for goal in summary.objectives)
    volume = "" if summary.hypervolume is None else f"; hypervolume {summary.hypervolume:g}, measured from {corner}"
    sets = f"{summary.evaluated:,} sets evaluated, {summary.feasible:,} feasible, {summary.size:,} on the front{volume}"
    return [*lines, sets]


def _baseline_line(summary: FrontSummary, baseline: FrontBaseline) -> str:
    units = {objective.name: unit_text(objective.unit) for objective in summary.objectives}
    amounts = ", ".join(f"{name} {amount:.6g}{units[name]}" for name, amount in baseline.objectives.items())
    broken = f"; it breaks constraints by {baseline.violation:.1%}" if baseline.violation > 0 else ""
    place = "sets of the front beat it" if baseline.rank is None else f"on the front, rank {baseline.rank}"
    return f"baseline: {amounts} ({place}){broken}"


def shown_of_front(rows: Sequence[FrontRow], limit: int) -> list[FrontRow]:
    """Returns `limit` sets of a front in their order; knee and best of each objective are kept even beyond the limit.

    Then come the sets that win often. The others are the first ones under weights, else spread over the front: each is the farthest from
    all that are kept.
    """
    kept = [place for place, row in enumerate(rows) if row.knee or row.best_in]
    winners = sorted(
        (place for place, row in enumerate(rows) if (row.wins or 0) >= OFTEN), key=lambda place: -(rows[place].wins or 0)
    )
    kept += [place for place in winners if place not in kept][: max(0, limit - len(kept))]
    others = [place for place in range(len(rows)) if place not in kept]
    if rows and rows[0].weighted is not None:
        kept += others[: max(0, limit - len(kept))]
    elif rows:
        kept += _spread(rows, kept or others[:1], min(limit, len(rows)) - len(kept))
    return [rows[place] for place in sorted(set(kept))]


def _spread(rows: Sequence[FrontRow], kept: Sequence[int], count: int) -> list[int]:
    """Returns `count` further places, by distances of the objectives, scaled to their ranges (Gonzalez 1985, Theoretical Computer Science
    38, Section 2)."""
    points = np.array([list(row.objectives.values()) for row in rows])
    ranges = np.ptp(points, axis=0)
    points = points / np.where(ranges > 0, ranges, 1.0)
    nearest = np.full(len(rows), np.inf)
    for place in kept:
        nearest = np.minimum(nearest, np.linalg.norm(points - points[place], axis=1))
    nearest[list(kept)] = -1.0
    places: list[int] = []
    for _ in range(count):
        places.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, np.linalg.norm(points - points[places[-1]], axis=1))
        nearest[places] = -1.0
    return places


def left_out_of_front(kept: Sequence[FrontRow], rows: Sequence[FrontRow]) -> str:
    """Returns how many sets of a front are shown, and which; empty if all are."""
    if len(kept) == len(rows):
        return ""
    others = "the first ones" if rows[0].weighted is not None else "sets spread over the front"
    return f"{len(kept):,} of {len(rows):,} sets: the knee, the best of each objective, those that win often, and {others}"


def front_marks(row: FrontRow) -> str:
    """Returns what is special about a set of a front; a star: it has a score of a reference."""
    marks = [*(["knee"] if row.knee else []), *(f"best {name}" for name in row.best_in), *(["*"] if row.reused else [])]
    if row.violation > 0:
        marks.append(f"breaks constraints by {row.violation:.1%}")
    return ", ".join(marks)

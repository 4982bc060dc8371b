"""The front of a campaign with objectives: its summary and some of its sets."""

from collections.abc import Sequence

from drivecal.contracts.results import FrontSummary
from drivecal.contracts.tables import FrontRow
from drivecal.report.markup import bullets, paragraph, table, verbatim
from drivecal.report.rows import Number, front_lines, front_marks, left_out_of_front, shown_of_front

SHOWN = 20
"""Sets that the page shows, if no more are marked."""


def parts(rows: Sequence[FrontRow], summary: FrontSummary | None, identifier: str, drawings: Sequence[str] = ()) -> list[str]:
    """Returns the section; nothing without objectives."""
    if summary is None:
        return []
    lines = [f"{line[0].upper()}{line[1:]}." for line in front_lines(summary)]
    if not rows:
        return [bullets(lines)]
    kept = shown_of_front(rows, SHOWN)
    caption = "The front: no other set is better in one objective without being worse in another"
    caption += f"; {left_out}" if (left_out := left_out_of_front(kept, rows)) else ""
    if any(row.reused for row in kept):
        caption += ". A star: a score is that of a reference"
    header = ["rank", *rows[0].objectives, *rows[0].constraints, "", *rows[0].parameters]
    cells = [
        [
            row.rank,
            *(Number(f"{amount:.6g}") for amount in (*row.objectives.values(), *row.constraints.values())),
            *(front_marks(row), *row.parameters.values()),
        ]
        for row in kept
    ]
    return [
        bullets(lines),
        *drawings,
        table(header, cells, caption),
        paragraph("All sets, and what one gains and costs against another:"),
        verbatim(f"drivecal front {identifier} --limit {len(rows)}"),
    ]

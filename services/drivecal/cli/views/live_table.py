"""Several campaigns in a table: with colours and live on a terminal, as plain columns elsewhere."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from drivecal.cli.views.output import OUTCOME_COLOURS, by_outcome, duration, print_columns
from drivecal.cli.views.progress import current_cells, stage_text
from drivecal.contracts.campaign import Campaign
from drivecal.domain.errors import UnavailableError

BARS = "▁▂▃▄▅▆▇█"
SPARKLINE_WIDTH = 16
STATE_STYLES = {"succeeded": "green", "failed": "bold red", "paused": "yellow", "running": "bold"}
ID_LENGTH = 8
"""Characters of an id that the table shows."""
GIVE_WAY = (*OUTCOME_COLOURS, "stage", "best so far", "left")
"""Columns that a narrow terminal does without, the first ones first."""
GAP = 2
"""Spaces between columns."""
SHORTEST_NAME = 12
"""Characters of the names for which other columns give way."""


@dataclass(frozen=True, slots=True)
class SearchedCampaign:
    """A campaign, and the best objective that its search knew after each iteration."""

    campaign: Campaign
    best: tuple[float, ...] = ()


def sparkline(values: Sequence[float], width: int = SPARKLINE_WIDTH) -> str:
    """Returns a line of bars, the least value low and the largest high; of more than `width` values the last of each part."""
    if len(values) > width:
        values = [values[(place + 1) * len(values) // width - 1] for place in range(width)]
    least, span = min(values, default=0.0), max(values, default=0.0) - min(values, default=0.0)
    return "".join(BARS[round((value - least) / span * (len(BARS) - 1)) if span else 0] for value in values)


def document(rows: Sequence[SearchedCampaign]) -> dict[str, Any]:
    """Returns the table for programs."""
    fields = {"id", "name", "state", "stage", "iteration", "progress", "best", "degraded", "error"}
    return {
        "items": [
            row.campaign.model_dump(mode="json", include=fields)
            | {"outcomes": by_outcome(current_cells(row.campaign)), "best_by_iteration": list(row.best)}
            for row in rows
        ]
    }


def print_plain(rows: Sequence[SearchedCampaign]) -> None:
    """Prints the table as columns that survive a pipe."""
    header, lines = _columns(rows)
    print_columns(header, [[cell.plain for cell in line] for line in lines])


def table(rows: Sequence[SearchedCampaign], width: int) -> Group:
    """Returns the table for a terminal of `width` characters, a line per campaign, with the campaigns' troubles below it."""
    header, lines, room = _fitting(*_columns(rows), width)
    drawn = Table(box=None, pad_edge=False, header_style="bold")
    for name in header:
        longest = room if name == "name" else None
        drawn.add_column(Text(name, OUTCOME_COLOURS.get(name, "")), no_wrap=True, overflow="ellipsis", max_width=longest)
    for line in lines:
        drawn.add_row(*line)
    campaigns = [row.campaign for row in rows]
    troubles = [(campaign.id[:ID_LENGTH], campaign.degraded or campaign.error) for campaign in campaigns]
    return Group(drawn, *(Text(f"{identifier}: {trouble}", "yellow") for identifier, trouble in troubles if trouble))


def show_live(read: Callable[[], Sequence[SearchedCampaign]], seconds: float, console: Console) -> None:
    """Shows the table anew every so many seconds until Ctrl-C.

    Raises DrivecalError if the first reading fails; a server that is away later is reported below the last table.
    """
    try:
        shown = table(read(), console.width)
        with Live(shown, console=console, auto_refresh=False) as live:
            while True:
                live.update(shown, refresh=True)
                time.sleep(seconds)
                try:
                    shown = table(read(), console.width)
                except UnavailableError as error:
                    live.update(Group(shown, Text(str(error), "yellow")), refresh=True)
                    time.sleep(seconds)
    except KeyboardInterrupt:
        return


def _columns(rows: Sequence[SearchedCampaign]) -> tuple[list[str], list[list[Text]]]:
    """Returns the header and the cells; outcomes that never occurred have no column."""
    counts = [by_outcome(current_cells(row.campaign)) for row in rows]
    outcomes = [name for name in OUTCOME_COLOURS if any(count[name] for count in counts)]
    header = ["id", "state", "stage", "done", *outcomes, "best so far", "best", "left", "name"]
    return header, [
        [
            *_place(row.campaign),
            *(Text(f"{count[name]:,}", OUTCOME_COLOURS[name], justify="right") for name in outcomes),
            Text(sparkline(row.best)),
            Text("-" if row.campaign.best is None else f"{row.campaign.best.objective:.3f}", justify="right"),
            Text(_left(row.campaign)),
            Text(row.campaign.name),
        ]
        for row, count in zip(rows, counts, strict=True)
    ]


def _fitting(header: list[str], lines: list[list[Text]], width: int) -> tuple[list[str], list[list[Text]], int]:
    """Returns the columns for which there is room beside the names, and the room of these."""
    sizes = {name: max([len(name), *(line[place].cell_len for line in lines)]) + GAP for place, name in enumerate(header)}
    sizes["name"] = SHORTEST_NAME
    for name in GIVE_WAY:
        if sum(sizes.values()) > width:
            sizes.pop(name, None)
    kept = [place for place, name in enumerate(header) if name in sizes]
    room = SHORTEST_NAME + max(0, width - sum(sizes.values()))
    return [header[place] for place in kept], [[line[place] for place in kept] for line in lines], room


def _place(campaign: Campaign) -> list[Text]:
    progress = campaign.progress
    done = f"{progress.done / progress.total:.0%} of {progress.total:,}" if progress.total else "-"
    stage = "-" if campaign.stage is None else stage_text(campaign)
    return [Text(campaign.id[:ID_LENGTH]), Text(campaign.state, STATE_STYLES.get(campaign.state, "")), Text(stage), Text(done)]


def _left(campaign: Campaign) -> str:
    seconds = campaign.progress.eta_seconds
    return "-" if seconds is None or campaign.state != "running" else duration(seconds)

"""Whether the search had found what it found: the criteria of the paper's Tables 5 and 7, and the iterations as a table."""

from collections.abc import Sequence

from drivecal.analysis.convergence import UNCHANGED_ALTERNATIVES, UNCHANGED_BEST, alternatives_at, best_at
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.tables import Generation
from drivecal.report.markup import table
from drivecal.report.rows import fixed

MOST_LINES = 13
"""Iterations that a table in the page shows; all of them are in the file."""


def convergence(generations: Sequence[Generation]) -> list[str]:
    """A sentence for each criterion. An iteration that is not answered yet takes no part."""
    answered = [generation for generation in generations if generation.best is not None]
    if not answered:
        return []
    best = [cell.best for cell in answered]
    counts = [cell.alternatives for cell in answered]
    return [
        _sentence(
            "The best objective",
            "its best objective",
            best_at(best),
            _last_change(best),
            len(answered),
            f"for at least {UNCHANGED_BEST} iterations (Table 5)",
        ),
        _sentence(
            "The number of alternative optima",
            "its number of alternative optima",
            alternatives_at(counts),
            _last_change(counts),
            len(answered),
            f"for more than {UNCHANGED_ALTERNATIVES} iterations (Table 7)",
        ),
    ]


def afterwards(campaign: Campaign, generations: Sequence[Generation]) -> str:
    """Text about cells that confirmed the best set, in no iteration; empty if there are none. Before the last iteration is finished
    those of an unfinished one are in none, too."""
    wanted = (campaign.spec.get("optimizer") or {}).get("iterations")
    added = campaign.cells.requested - sum(generation.requested for generation in generations)
    if len(generations) != wanted or added <= 0:
        return ""
    cells = "1 cell was" if added == 1 else f"{added:,} cells were"
    return (
        f"After the last iteration {cells} asked for to confirm the best set by simulation. Iterations neither count nor know them: their "
        "objectives are those that the search believed."
    )


def _sentence(what: str, of_it: str, converged: int | None, changed: int, iterations: int, criterion: str) -> str:
    if converged is not None:
        return f"Converged by {of_it}: found in iteration {converged} of {iterations}, it then stayed as it was {criterion}."
    if changed == 1:
        return (
            f"{what} never changed in {iterations} iterations, too few to call it converged: it would have to stay {criterion}."
        )
    return (
        f"Not converged by {of_it}: it last changed in iteration {changed} of {iterations}, and would have to stay {criterion}."
    )


def _last_change(values: Sequence[float | None]) -> int:
    """The iteration, counted from 1, since which nothing has changed."""
    last = len(values) - 1
    return next((index + 2 for index in range(last - 1, -1, -1) if values[index] != values[last]), 1)


def shown(generations: Sequence[Generation]) -> list[Generation]:
    """At most MOST_LINES iterations, evenly, the first and the last among them."""
    last = len(generations) - 1
    if last < MOST_LINES:
        return list(generations)
    return [generations[round(line * last / (MOST_LINES - 1))] for line in range(MOST_LINES)]


def population_table(generations: Sequence[Generation]) -> str:
    """Returns Figure 10 as a table."""
    lines = shown(generations)
    rows = [
        [line.iteration + 1, *(fixed(value, 3) for value in (line.best, line.mean, line.minimum)), line.alternatives]
        for line in lines
    ]
    some = "" if len(lines) == len(generations) else f"; {len(lines)} of {len(generations)} iterations, all in generations.csv"
    return table(["iteration", "best", "mean", "minimum", "alternatives"], rows, f"Figure 10 in numbers{some}")

"""Convergence of the search by the criteria of the paper's Tables 5 and 7, and the iterations as a table."""

from collections.abc import Mapping, Sequence

from drivecal.analysis.convergence import UNCHANGED_ALTERNATIVES, UNCHANGED_BEST, alternatives_at, best_at, changes, last_change
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.results import FrontSummary
from drivecal.contracts.tables import Generation
from drivecal.report.markup import table
from drivecal.report.rows import fixed

MOST_LINES = 13
"""Iterations that a table in the page shows; all of them are in the file."""


def convergence(generations: Sequence[Generation], front: FrontSummary | None = None) -> list[str]:
    """Returns a sentence for each criterion; nothing before the first result, and of several objectives, for the criteria are about a best
    set and not about a `front`. Unanswered iterations at the end are left out."""
    if front is not None and len(front.objectives) > 1:
        return []
    answered = [place for place, generation in enumerate(generations, 1) if generation.best is not None]
    if not answered:
        return []
    best = [generation.best for generation in generations[: answered[-1]]]
    alternatives = [generation.alternatives for generation in generations[: answered[-1]]]
    for_the_best = f"for at least {UNCHANGED_BEST} iterations"
    for_the_alternatives = f"for more than {UNCHANGED_ALTERNATIVES} iterations"
    return [
        _sentence("best objective", best, best_at(best), for_the_best),
        _sentence(
            "number of alternative optima",
            changes(best, alternatives),
            alternatives_at(best, alternatives),
            for_the_alternatives,
        ),
    ]


def afterwards(campaign: Campaign, generations: Sequence[Generation]) -> str:
    """Returns a text about the cells of no iteration, which confirmed the best set; empty without them or before the last iteration."""
    wanted = (campaign.spec.get("optimizer") or {}).get("iterations")
    added = campaign.cells.requested - sum(generation.requested for generation in generations)
    if len(generations) != wanted or added <= 0:
        return ""
    cells = "1 cell was" if added == 1 else f"{added:,} cells were"
    return (
        f"After the last iteration {cells} asked for to confirm the best set by simulation. Iterations neither count nor know them: their "
        "objectives are those that the search believed."
    )


def _sentence(what: str, values: Sequence[float | None], converged: int | None, criterion: str) -> str:
    of = f"of {len(values)}"
    by = f"by the paper's criterion for the {what}"
    if converged is not None:
        return f"Converged {by}: found in iteration {converged} {of}, it then stayed as it was {criterion}."
    changed = last_change(values)
    wanted = f"would have to stay {criterion}."
    if changed == 1:
        return f"The {what} never changed in {len(values)} iterations, too few to call it converged: it {wanted}"
    return f"Not converged {by}: it last changed in iteration {changed} {of}, and {wanted}"


def shown(generations: Sequence[Generation]) -> list[Generation]:
    """Returns at most MOST_LINES iterations, evenly spread, with the first and the last."""
    last = len(generations) - 1
    if last < MOST_LINES:
        return list(generations)
    return [generations[round(line * last / (MOST_LINES - 1))] for line in range(MOST_LINES)]


def in_numbers(
    title: str, header: Sequence[str], rows: Mapping[int, Sequence[object]], generations: Sequence[Generation]
) -> str:
    """Returns a table with the rows of the `shown` iterations, by iteration."""
    lines = [[line.iteration + 1, *rows[line.iteration]] for line in shown(generations)]
    some = "" if len(lines) == len(generations) else f"; {len(lines)} of {len(generations)} iterations, all in generations.csv"
    return table(["iteration", *header], lines, title + some)


def population_table(generations: Sequence[Generation]) -> str:
    """Returns Figure 10 as a table."""
    rows = {
        line.iteration: [*(fixed(value, 3) for value in (line.best, line.mean, line.minimum)), line.alternatives]
        for line in generations
    }
    return in_numbers("The course of the search in numbers", ["best", "mean", "worst", "alternatives"], rows, generations)

"""The sets that share the best objective: their number, common values and regions (Section IV-C)."""

from collections.abc import Iterable, Sequence

from drivecal.analysis.optima import NEIGHBOURS
from drivecal.contracts.assignments import value_text
from drivecal.contracts.setup import SearchedParameter
from drivecal.contracts.tables import OptimumRow, Solution
from drivecal.report.markup import paragraph, table
from drivecal.report.rows import Number, fixed

MOST_REGIONS = 12
"""Regions that are listed."""


def searched(parameters: Iterable[SearchedParameter]) -> list[SearchedParameter]:
    """Returns the parameters that are not held."""
    return [parameter for parameter in parameters if parameter.fixed is None]


def constant(sets: Sequence[Solution], parameters: Iterable[SearchedParameter]) -> dict[str, float | str]:
    """Returns the parameters that have one value in all of the sets; empty for a single set."""
    if len(sets) < 2:
        return {}
    values = {each.name: {parameter_set.parameters[each.name] for parameter_set in sets} for each in parameters}
    return {name: next(iter(seen)) for name, seen in values.items() if len(seen) == 1}


def count(number: int, what: str) -> str:
    """Returns a number with a noun: `1 set`, `2 sets`."""
    return f"{number:,} {what}{'' if number == 1 else 's'}"


def summary(optima: Sequence[OptimumRow]) -> str:
    """Returns the numbers of sets and regions."""
    regions = len({optimum.region for optimum in optima})
    share = "shares" if len(optima) == 1 else "share"
    return f"{count(len(optima), 'set')} that {share} the best objective, in {count(regions, 'distinct region')}."


def parts(
    optima: Sequence[OptimumRow], total: int, parameters: Sequence[SearchedParameter], drawings: Sequence[str]
) -> list[str]:
    """Returns the section: sets and regions, the figure, the table of regions. `total`: number of sets; `optima` are the first."""
    same = constant(optima, searched(parameters))
    text = f"The search found {summary(optima)}"
    if total > len(optima):
        text = f"The search found {total:,} sets that share the best objective. Of these here: {summary(optima)}"
    if len(optima) > 1:
        if same:
            text += f" In all of them {', '.join(f'{name} = {value_text(value)}' for name, value in same.items())}."
        else:
            text += " No searched parameter has the same value in all of them."
    return [paragraph(text), *drawings, regions_table(optima)]


def regions_table(optima: Sequence[OptimumRow]) -> str:
    """Returns the table of regions, by their best-ranked set."""
    groups: dict[int, list[OptimumRow]] = {}
    for optimum in optima:
        groups.setdefault(optimum.region, []).append(optimum)
    first = sorted(groups.items())[:MOST_REGIONS]
    rows = [[region, len(members), members[0].rank, *_to_worse(members)] for region, members in first]
    caption = (
        f"Regions: chains of sets that are at most {NEIGHBOURS:g} apart (root mean square, in shares of the searched ranges). A set that "
        "lies far from every worse one bears small changes of its parameters"
    )
    if len(groups) > MOST_REGIONS:
        caption += f"; the first {MOST_REGIONS} of {len(groups)}, all in optima.csv"
    header = ["region", "sets", "best rank", "nearest worse set: least distance", "largest distance"]
    return table(header, rows, caption, wrap_header=True)


def _to_worse(members: Iterable[OptimumRow]) -> list[Number | None]:
    known = [member.to_worse for member in members if member.to_worse is not None]
    return [fixed(min(known), 3), fixed(max(known), 3)] if known else [None, None]

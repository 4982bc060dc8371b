"""Rows and sentences that the page of a report and the command line share."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import groupby
from typing import Literal

import numpy as np

from drivecal.contracts.campaign import ErrorRate, Released
from drivecal.contracts.evaluation import FailureCause
from drivecal.contracts.results import FrontBaseline, FrontSummary
from drivecal.contracts.tables import FrontRow, InfluenceRow, ValidationRow
from drivecal.domain.scales import COMFORT, Scale, objective_text, unit_text

OUTCOMES = ("simulated", "repeated", "reused", "predicted", "certified", "failed")
"""Outcomes of requested cells, frequent ones first."""


class Emphasized(str):
    """The text of a table's cell that stands out."""

    __slots__ = ()


class Number(str):
    """A number that is written already."""

    __slots__ = ()


def fixed(value: float | None, digits: int, separator: Literal["", ","] = "") -> Number | None:
    """Returns a number with so many decimals and the `separator` of thousands; None for an unknown value."""
    return None if value is None else Number(f"{value:{separator}.{digits}f}")


def objective_number(value: float | None) -> Number | None:
    """Returns an objective as `objective_text` writes it; None for an unknown one."""
    return None if value is None else Number(objective_text(value))


def percent(share: float | None, digits: int = 2) -> Number | None:
    """Returns a share in percent; None for an unknown share."""
    return None if share is None else Number(f"{share:.{digits}%}")


def bound(upper_95: float | None) -> Number | str | None:
    """Returns a 95 % bound of a share in percent; for 100 %, which excludes nothing, that there is none, and None for an unknown one."""
    return "no bound" if upper_95 is not None and upper_95 >= 1.0 else percent(upper_95)


def totals(items: Iterable[object], *names: str) -> tuple[int, ...]:
    """Returns the sum of each of the named fields over all items."""
    listed = list(items)
    return tuple(sum(getattr(item, name) for item in listed) for name in names)


def errors_text(what: str, count: int, different: int, wrong: int, scale: Scale = COMFORT) -> str:
    """Returns a sentence about `count` compared answers, whose plural is `what`.

    Wrong answers are off by more than the tolerance: R_err alone does not say how many are off by less. Nearly all scores without steps
    are, a little.
    """
    differ = "" if scale.step is None else f"{different:,} had another score ({different / count:.2%}); "
    tolerated = scale.amount(scale.tolerance)
    return f"Of {count:,} {what} {differ}{wrong:,} were wrong, off by more than {tolerated} (R_err {wrong / count:.2%})."


def range_text(scale: Scale) -> str:
    """Returns the usual range of a score and which end is better."""
    return f"{scale.lower:g} to {scale.upper:g}, {'higher' if scale.sign > 0 else 'lower'} is better"


def interval_text(rows: Sequence[ValidationRow]) -> str:
    """A sentence about the 95 % intervals of a validation; empty if nothing was compared."""
    over = {row.interval_over for row in rows if row.compared}
    if not over:
        return ""
    if all(row.released is not None for row in rows):
        return (
            "Each 95 % interval is that of a binomial share (Clopper-Pearson): each simulated prediction is a draw of its own from the "
            "released ones."
        )
    if over == {"bases"}:
        return (
            "Each 95 % interval is one of the mean over base sets (by betting, for any distribution), because variants of one base set are "
            "alike. More base sets narrow it, more variants of each hardly do."
        )
    return (
        "These 95 % intervals (Clopper-Pearson) are too narrow: an earlier version of drivecal took the variants of one base set as "
        "independent. `drivecal validate ID --again` repeats the study."
    )


PREDICTIONS = [
    "scenario",
    "released",
    "simulated",
    "different",
    "beyond tolerance",
    "per prediction in lots",
    "limit",
    "wrong",
    "R_err",
    "95 % interval",
]
"""Columns of `predictions`."""


def _per_inspected(row: ValidationRow) -> float | None:
    """Errors released for each prediction in a lot, if those that were drawn are like the others."""
    if not row.compared or not row.inspected:
        return None
    return (row.beyond or 0) / row.bases * (row.released or 0) / row.inspected


def predictions(rows: Iterable[ValidationRow]) -> list[list[object]]:
    """Returns a row per scenario of a validation of released predictions."""
    return [
        [
            *(row.scenario, row.released, row.compared, row.different, row.beyond),
            percent(_per_inspected(row)),
            *(percent(row.limit, 1), row.wrong, percent(row.error_rate)),
            None if row.lower_95 is None or row.upper_95 is None else Number(f"{row.lower_95:.2%} to {row.upper_95:.2%}"),
        ]
        for row in rows
    ]


def error_rates(rates: Mapping[str, ErrorRate]) -> list[list[object]]:
    """Returns a row per scenario that was audited, or whose results contradict each other."""
    return [
        [
            *(name, rate.audited, rate.different, rate.wrong),
            percent(rate.wrong / rate.audited if rate.audited else None),
            *(bound(rate.upper_95), rate.contradictions, rate.lots, rate.rejected),
            Emphasized("stopped") if rate.stopped else "on",
        ]
        for name, rate in rates.items()
        if rate.audited or rate.stopped or rate.contradictions
    ]


FAILURES = ("cells", "what", "cause", "last message", "scenarios", "example")
_WHAT = {"no_result": "no result", "failed": "failed run", "unscored": "score without a value"}


def failure_causes(causes: Sequence[FailureCause]) -> list[list[object]]:
    """Returns a row per cause of failed cells, as `FAILURES` names the columns."""
    return [
        [
            *(cause.cells, _WHAT[cause.kind], cause.cause, shortened(cause.detail), " ".join(cause.scenarios[:5])),
            str(cause.example),
        ]
        for cause in causes
    ]


LONGEST_MESSAGE = 160
OFTEN = 0.03
"""Share of all weightings from which on a set of a front wins often."""


def shortened(words: str | None) -> str | None:
    """Returns the end of a message, where simulators say what is wrong."""
    return words if words is None or len(words) <= LONGEST_MESSAGE else f"...{words[3 - LONGEST_MESSAGE :]}"


LOTS_NOTE = (
    "limit holds for the expected number of errors over all lots together, by the rule that releases them; the 95 % bound is what the "
    "samples of this campaign alone prove, even if all are right: a few samples of a lot prove little about its other answers"
)
"""Explains a bound beside a smaller limit."""


def exceeds_limit(released: Mapping[str, Released]) -> bool:
    """Returns whether a bound is above its limit, which needs `LOTS_NOTE`."""
    return any(lots.upper_95 is not None and lots.upper_95 > lots.limit for lots in released.values())


LOTS = ("scenario", "asked", "lots", "rejected", "released", "sampled", "beyond tolerance", "limit", "at most (95 %)")
"""Columns of `released_lots`. As in `PREDICTIONS`, those beyond the tolerance are errors, others that differ are not."""


def released_lots(released: Mapping[str, Released]) -> list[list[object]]:
    """Returns a row per scenario with inspected lots of predicted answers."""
    return [
        [
            *(name, lots.asked, lots.lots, lots.rejected, lots.predicted, lots.sampled, lots.different),
            *(percent(lots.limit, 1), bound(lots.upper_95)),
        ]
        for name, lots in released.items()
        if lots.lots
    ]


def by_scenario(rows: Iterable[InfluenceRow]) -> dict[str, list[InfluenceRow]]:
    """Returns the rows of each scenario, in order."""
    return {scenario: list(members) for scenario, members in groupby(rows, key=lambda row: row.scenario)}


def segment(row: InfluenceRow) -> tuple[float, float] | None:
    """Returns the influential part of a parameter's range, from 0 (its lower bound) to 1 (its upper bound); None if nothing is."""
    if not row.influential:
        return None
    if row.space_lower is None or row.space_upper is None:
        return 0.0, 1.0
    size = row.space_upper - row.space_lower
    lower = 0.0 if row.lower is None else (row.lower - row.space_lower) / size
    upper = 1.0 if row.upper is None else (row.upper - row.space_lower) / size
    return lower, upper


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


def shown_of_front(rows: Sequence[FrontRow], limit: int, chosen: Collection[int] = ()) -> list[FrontRow]:
    """Returns `limit` sets of a front in their order; knee, best of each objective and ranks `chosen` are kept even beyond the limit. Then
    come those that win often. The others are the first ones under weights, else spread over the front: each is the farthest from all that
    are kept."""
    kept = [place for place, row in enumerate(rows) if row.knee or row.best_in or row.rank in chosen]
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

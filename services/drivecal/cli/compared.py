"""What changes between two robustness studies of the same sets, as in a plain and a hybrid vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import combinations

import typer

from drivecal.cli.output import parameters_text, print_columns
from drivecal.contracts.studies import RobustnessRow


@dataclass(frozen=True, slots=True)
class Difference:
    """Between two studies; pairs are (this one's, the other one's).

    `degrees`, `scores`: how many are equal, lower and higher in the other study, of sets and of (set, scenario) pairs; `mean_degree`:
    where a degree is only known to be at least so large, that counts. `tau`: Kendall's rank correlation (tau-a) of both orders, None for
    fewer than two sets.
    """

    sets: int
    only_one: int
    degrees: tuple[int, int, int]
    mean_degree: tuple[float, float]
    scores: tuple[int, int, int]
    tau: float | None
    same_recommended: bool


def pairs_of(rows: Sequence[RobustnessRow], others: Sequence[RobustnessRow]) -> list[tuple[RobustnessRow, RobustnessRow]]:
    """The sets that both have, in the order of the first."""
    known = {_key(row): row for row in others}
    return [(row, known[_key(row)]) for row in rows if _key(row) in known]


def difference(rows: Sequence[RobustnessRow], others: Sequence[RobustnessRow]) -> Difference:
    """What changes."""
    pairs = pairs_of(rows, others)
    count = max(len(pairs), 1)
    ranks = [(one.rank, other.rank) for one, other in pairs]
    concordant = [(a[0] - b[0]) * (a[1] - b[1]) > 0 for a, b in combinations(ranks, 2)]
    scores = [
        (score, other.scores[scenario])
        for one, other in pairs
        for scenario, score in one.scores.items()
        if score is not None and other.scores.get(scenario) is not None
    ]
    return Difference(
        sets=len(pairs),
        only_one=len(rows) + len(others) - 2 * len(pairs),
        degrees=_changes([(one.degree, other.degree) for one, other in pairs]),
        mean_degree=(sum(one.degree for one, _ in pairs) / count, sum(other.degree for _, other in pairs) / count),
        scores=_changes([(here, there) for here, there in scores if there is not None]),
        tau=2 * sum(concordant) / len(concordant) - 1 if concordant else None,
        same_recommended=[_key(row) for row in rows if row.recommended] == [_key(row) for row in others if row.recommended],
    )


def document(rows: Sequence[RobustnessRow], others: Sequence[RobustnessRow]) -> dict[str, object]:
    """All of it for programs."""
    return {
        "difference": asdict(difference(rows, others)),
        "here": [row.model_dump(mode="json") for row in rows],
        "there": [row.model_dump(mode="json") for row in others],
    }


def print_difference(rows: Sequence[RobustnessRow], others: Sequence[RobustnessRow]) -> None:
    """Prints both studies side by side, and what changes in words."""
    print_columns(
        ["rank", "degree", "objective", "scores that differ", "parameters"],
        [
            [
                _both(one.rank, other.rank),
                _both(_degree(one), _degree(other)),
                _both(_objective(one), _objective(other)),
                ", ".join(
                    f"{name} {_both(score, other.scores.get(name))}"
                    for name, score in one.scores.items()
                    if score != other.scores.get(name)
                ),
                parameters_text(one.parameters),
            ]
            for one, other in pairs_of(rows, others)
        ],
    )
    found = difference(rows, others)
    here, there = found.mean_degree
    lines = [f"{found.sets} sets in both studies" + (f", {found.only_one} in one of them alone" if found.only_one else "")]
    lines.append("degrees: {} equal, {} lower, {} higher".format(*found.degrees) + f"; mean {here:.2f} to {there:.2f}")
    lines.append("scores in the nominal vehicle: {} equal, {} lower, {} higher".format(*found.scores))
    if found.tau is not None:
        lines.append(f"ranking: Kendall's tau {found.tau:.2f}")
    lines.append(f"recommended: {'the same set' if found.same_recommended else 'another set'}")
    typer.echo("\n".join(lines))


def _key(row: RobustnessRow) -> tuple[tuple[str, float], ...]:
    return tuple(sorted(row.parameters.items()))


def _changes(pairs: Sequence[tuple[int, int]]) -> tuple[int, int, int]:
    return sum(a == b for a, b in pairs), sum(b < a for a, b in pairs), sum(b > a for a, b in pairs)


def _both(here: object, there: object) -> str:
    shown = ["-" if one is None else str(one) for one in (here, there)]
    return shown[0] if shown[0] == shown[1] else " -> ".join(shown)


def _degree(row: RobustnessRow) -> str:
    return f">= {row.degree}" if row.at_least else str(row.degree)


def _objective(row: RobustnessRow) -> str | None:
    return None if row.objective is None else f"{row.objective:.3f}"

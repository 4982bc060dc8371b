"""Differences between two robustness studies of the same sets, as in a plain and a hybrid vehicle."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drivecal.contracts.tables import RobustnessRow


@dataclass(frozen=True, slots=True)
class StudyDifference:
    """Between two studies; pairs are (this one's, the other one's).

    `degrees`, `scores`: how many are equal, lower and higher in the other study, of sets and of (set, scenario) pairs; `mean_degree`:
    where a degree is only known to be at least so large, that counts. `tau`: Kendall's rank correlation of both orders (no ties), None for
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
    known = {key_of(row.parameters): row for row in others}
    return [(row, known[key_of(row.parameters)]) for row in rows if key_of(row.parameters) in known]


def difference(rows: Sequence[RobustnessRow], others: Sequence[RobustnessRow]) -> StudyDifference:
    """Returns the changes from one study to the other."""
    pairs = pairs_of(rows, others)
    count = max(len(pairs), 1)
    ranks = [(row.rank, other.rank) for row, other in pairs]
    scores = [
        (score, other.scores[scenario])
        for row, other in pairs
        for scenario, score in row.scores.items()
        if score is not None and other.scores.get(scenario) is not None
    ]
    from scipy.stats import kendalltau  # takes more than a second, which commands that only look things up need not pay

    return StudyDifference(
        sets=len(pairs),
        only_one=len(rows) + len(others) - 2 * len(pairs),
        degrees=_changes([(row.degree, other.degree) for row, other in pairs]),
        mean_degree=(sum(row.degree for row, _ in pairs) / count, sum(other.degree for _, other in pairs) / count),
        scores=_changes([(here, there) for here, there in scores if there is not None]),
        tau=float(kendalltau(*zip(*ranks, strict=True)).statistic) if len(ranks) > 1 else None,
        same_recommended=[key_of(row.parameters) for row in rows if row.recommended]
        == [key_of(row.parameters) for row in others if row.recommended],
    )


def key_of(parameters: Mapping[str, float | str]) -> tuple[tuple[str, float | str], ...]:
    """Returns a key of a parameter set, by which rows of two studies are compared."""
    return tuple(sorted(parameters.items()))


def _changes(pairs: Sequence[tuple[float, float]]) -> tuple[int, int, int]:
    return sum(a == b for a, b in pairs), sum(b < a for a, b in pairs), sum(b > a for a, b in pairs)

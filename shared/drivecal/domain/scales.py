"""Scales: what a score's numbers mean. Everything that compares scores reads the scale instead of assuming 0 to 7 with 7 best."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from math import ceil

from drivecal.domain.rounding import SHARE, grain

LARGEST_EXACT = 2**53
"""Whole numbers below it are the same as floats."""
SMALL, LARGE = 0.01, 1e6
"""Objectives between them have four decimals."""
MOST_BARS = 100
"""Bars on each side of a histogram of differences, without the outermost, which holds all that is beyond the span."""


class Direction(StrEnum):
    """Sense of a score: larger ones or smaller ones are better."""

    MAXIMISE = "maximise"
    MINIMISE = "minimise"


@dataclass(frozen=True, slots=True)
class Scale:
    """Scale of a score, in the score's own units.

    `lower` and `upper` are the ends of the usual range: the unit of relative measures (s_rel, figures), no bounds of the values.
    `tolerance` is the largest difference that is no error: scores that differ by more are wrong (Eq. 8 of the paper). `failed` is the
    worth of a failed run; it lies at the worst end of the range or beyond, and no score is worse. `step` is the distance of
    neighbouring scores if only multiples of it occur, else None.
    """

    name: str
    direction: Direction
    lower: float
    upper: float
    tolerance: float
    failed: float
    step: float | None = None
    unit: str = "1"

    @property
    def sign(self) -> int:
        """1 if larger scores are better, else -1: `sign * score` is higher for better scores."""
        return 1 if self.direction is Direction.MAXIMISE else -1

    @property
    def span(self) -> float:
        """Width of the usual range."""
        return self.upper - self.lower

    @property
    def is_whole(self) -> bool:
        """True if every score is a whole number."""
        return self.step is not None and self.step.is_integer()

    def is_better(self, score: float, other: float) -> bool:
        """Returns whether `score` is better than `other`."""
        return self.sign * score > self.sign * other

    def worth(self, score: float, *, failed: bool = False) -> float:
        """Returns what a run counts: a failed run is worth `failed`, and no run is worth less."""
        return self.failed if failed or self.cuts(score) else score

    def cuts(self, score: float) -> bool:
        """Returns whether a score is worse than `failed`, so that it counts as a failed run's."""
        return self.is_better(self.failed, score)

    @property
    def rounding(self) -> float:
        """Largest difference of scores that count as equal."""
        return 0.0 if self.step is not None else self.grain

    @property
    def grain(self) -> float:
        """Largest difference of numbers on the scale that is rounding."""
        return grain(self.lower, self.upper, span=self.span)

    @property
    def largest_agreeing(self) -> float:
        """Largest difference of agreeing scores: the tolerance, with room for rounding."""
        return self.tolerance + self.grain

    def is_wrong(self, difference: float) -> bool:
        """Returns whether scores with this difference count as wrong."""
        return abs(difference) > self.largest_agreeing

    @property
    def bin(self) -> float:
        """Width of a bar in a histogram of differences: a step, else such that the middle bar ends at the tolerance, but not too narrow."""
        narrowest = self.span / MOST_BARS
        return self.step if self.step is not None and self.step >= narrowest else max(2 * self.tolerance, narrowest)

    @property
    def last_bar(self) -> int:
        """Number of the bar with differences of the span, from 0 in the middle; the next one holds all beyond."""
        return max(1, ceil(self.span / self.bin - 0.5 - SHARE))

    def amount(self, value: float) -> str:
        """Returns a difference of scores with its unit, for readers."""
        unit = self.unit.removesuffix("s") if value == 1 and self.unit == COMFORT.unit else self.unit
        return f"{value:g}{unit_text(unit)}"


def unit_text(unit: str | None) -> str:
    """Returns a unit for readers, after a space; nothing for values without unit."""
    return "" if unit in {None, "", "1"} else f" {unit}"


def objective_text(objective: float) -> str:
    """Returns an objective for readers, with four decimals, or with six significant digits if it is small or large."""
    return f"{objective:.4f}" if objective == 0 or SMALL <= abs(objective) < LARGE else f"{objective:.6g}"


def score_text(score: float | None) -> str:
    """Returns a score for readers: whole ones with all digits, others with at most six significant ones; a dash without one."""
    if score is None:
        return "-"
    known = plain(score)
    return str(known) if isinstance(known, int) else f"{known:.6g}"


def plain(score: float) -> float:
    """Returns whole scores as integers: 6 and not 6.0, whatever stored or computed them."""
    return int(score) if float(score).is_integer() and abs(score) < LARGEST_EXACT else float(score)


COMFORT = Scale("comfort", Direction.MAXIMISE, lower=0.0, upper=7.0, tolerance=1.0, failed=0.0, step=1.0, unit="points")
"""The paper's comfort score (Section IV-A): whole points from 0 to 7, 7 best; wrong is more than a point off (Eq. 8)."""

"""Settings of a sensitivity analysis."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any, Literal

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.sensitivity.thresholds import MuSigmaThresholds, Threshold, tolerance_text


@dataclass(frozen=True, slots=True)
class SensitivitySettings:
    """`design`: how the intervals are analysed; `intervals`: n_Int per parameter; `samples`: r effects per analysis; `seed`: of all points.

    `sequential`: the design `lines` makes only the runs that its bounds take. `paper` makes all of Equation 3 in any case.

    Raises InvalidInputError naming every setting that cannot be used, under `sensitivity`.
    """

    design: Literal["lines", "paper"]
    intervals: int
    samples: int
    threshold: Threshold
    seed: int
    sequential: bool = True

    def __post_init__(self) -> None:
        problems: list[Problem] = []
        if self.design not in {"lines", "paper"}:
            problems.append(_problem("design", f"there is no design {self.design!r}", "give lines or paper"))
        if self.intervals < 1:
            problems.append(_problem("intervals", f"{self.intervals} is too small", "give at least 1"))
        if self.samples < 2:
            problems.append(
                _problem("samples", f"{self.samples} is too small: a standard deviation takes two", "give at least 2")
            )
        if self.seed < 0:
            problems.append(_problem("seed", f"{self.seed} is negative", "give at least 0"))
        if isinstance(self.threshold, MuSigmaThresholds):
            limits = {"threshold.mu": self.threshold.mu, "threshold.sigma": self.threshold.sigma}
        else:
            limits = {} if self.threshold == "auto" else {"threshold": self.threshold}
        for name, limit in limits.items():
            if not isfinite(limit) or limit <= 0:
                remedy = "give a number above 0" + (" or auto" if name == "threshold" else "")
                problems.append(_problem(name, f"{limit} is not a usable threshold", remedy))
        if problems:
            raise InvalidInputError(*problems)


def caveats(stored: Mapping[str, Any]) -> list[str]:
    """Returns what a map cannot show because of the settings that are stored with it, for readers: a line each, none for most settings."""
    lines = [tolerance_text(stored["samples"])] if stored["threshold"] == "auto" else []
    if stored.get("sequential") and stored["design"] == "lines":
        lines.append(
            "sequential analysis: intervals between influential ones took no runs, so a larger s_rel may be hidden there"
        )
    return lines


def _problem(name: str, message: str, remedy: str) -> Problem:
    return Problem(f"sensitivity.{name}", message, remedy)

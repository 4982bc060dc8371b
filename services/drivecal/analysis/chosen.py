"""Reasons for trust in a set that was chosen, in the place of those for the best set of its search. Pure."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from drivecal.analysis.goals import EQUAL
from drivecal.contracts.assignments import value_text
from drivecal.contracts.results import Light, Reason
from drivecal.domain.scales import unit_text

AT_END = 0.005
"""Distance from an end of its range, as a share of it, up to which a value lies at the end."""


@dataclass(frozen=True, slots=True)
class BesideBaseline:
    """The value of an objective beside the baseline's. `sign`: 1 if more is better, else -1; `tolerance`: differences that do not count."""

    name: str
    value: float
    baseline: float
    sign: int
    unit: str = "1"
    tolerance: float = 0.0

    @property
    def gain(self) -> float:
        """By how much the value is better; below 0 if it is worse."""
        return self.sign * (self.value - self.baseline)

    @property
    def is_alike(self) -> bool:
        """Whether the difference does not count."""
        return abs(self.gain) <= max(EQUAL, self.tolerance)

    @property
    def text(self) -> str:
        """Returns the comparison in words."""
        unit = unit_text(self.unit)
        change = (
            "equal" if abs(self.gain) <= EQUAL else f"{'better' if self.gain > 0 else 'worse'} by {abs(self.gain):.4g}{unit}"
        )
        tolerated = f", within the tolerance of {self.tolerance:.4g}{unit}" if self.is_alike and abs(self.gain) > EQUAL else ""
        return f"{self.name} {self.value:.6g}{unit}, baseline {self.baseline:.6g}{unit}: {change}{tolerated}"


@dataclass(frozen=True, slots=True)
class Chosen:
    """A set that was chosen. `compared`: the objectives that the baseline has as well; `copied`: scenarios whose score is a reference's;
    violations in shares. `is_judged`: whether every objective and constraint has a value; `is_best`: whether the search ended with it."""

    parameters: Mapping[str, float | str]
    compared: Sequence[BesideBaseline] = ()
    copied: Sequence[str] = ()
    violation: float = 0.0
    baseline_violation: float = 0.0
    is_judged: bool = True
    is_best: bool = False


def reasons_for(chosen: Chosen, ranges: Mapping[str, tuple[float, float]]) -> Iterator[Reason]:
    """Yields the reasons of a chosen set: constraints, origin of its scores, baseline, values at an end of their `ranges`."""
    if not chosen.is_judged:
        text = "The chosen set has no value of an objective or a constraint of the campaign: not every scenario has a result of its own."
        yield Reason(light="red", about="end", text=text)
        return
    if chosen.violation > 0:
        text = f"The chosen set breaks the constraints by {chosen.violation:.1%}."
        yield Reason(light="red", about="constraints", text=text)
    if chosen.copied:
        text = f"This very set was not simulated in {', '.join(chosen.copied)}: its scores there are copied."
        yield Reason(light="amber", about="confirmation", text=text)
    else:
        yield every_score_is_known("the chosen set")
    yield from _baseline(chosen)
    yield from at_ends("the chosen set", chosen.parameters, ranges)


def _baseline(chosen: Chosen) -> Iterator[Reason]:
    if chosen.violation < chosen.baseline_violation:
        yield baseline_breaks_more("the chosen set")
    elif chosen.compared:
        counted = [each.gain for each in chosen.compared if not each.is_alike]
        light: Light | Literal["neutral"] = "amber"
        if counted:
            light = "green" if min(counted) > 0 else "amber"
        elif max(each.gain for each in chosen.compared) > EQUAL:
            light = "neutral"
        text = f"The chosen set beside the baseline: {'; '.join(each.text for each in chosen.compared)}."
        yield Reason(light=light, about="baseline", text=text)


def every_score_is_known(subject: str) -> Reason:
    """Returns the reason that no score is a reference's or predicted."""
    text = f"Every score of {subject} was simulated, repeats a simulation or provably equals one."
    return Reason(light="green", about="confirmation", text=text)


def baseline_breaks_more(subject: str) -> Reason:
    """Returns the reason that the baseline keeps the constraints worse."""
    text = f"The baseline breaks the constraints more than {subject}."
    return Reason(light="green", about="baseline", text=text)


def at_ends(subject: str, values: Mapping[str, float | str], ranges: Mapping[str, tuple[float, float]]) -> Iterator[Reason]:
    """Yields the reason that names the values of a set at an end of their ranges."""
    at_end = [
        f"{name} ({value_text(value)})"
        for name, ends in ranges.items()
        if isinstance(value := values.get(name), float | int)
        and min(abs(value - end) for end in ends) <= AT_END * (ends[1] - ends[0])
    ]
    if at_end:
        lie = "lies at or near an end of its range" if len(at_end) == 1 else "lie at or near an end of their ranges"
        text = f"In {subject} {', '.join(at_end)} {lie}; a wider range may hold better sets."
        yield Reason(light="green", about="search", text=text)

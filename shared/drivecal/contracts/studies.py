"""Answers about a campaign's results as a whole: its studies (robustness and validation), and the front of its objectives."""

from datetime import datetime
from typing import Any, Literal, get_args

from pydantic import Field

from drivecal.contracts.campaign import Answer, Page, Score

StudyName = Literal["robustness", "validation"]
STUDIES: tuple[StudyName, ...] = get_args(StudyName)


class Study(Answer):
    """A study of what a campaign found, made by that `campaign` itself or by another one; `settings` as in its specification, `vehicle`:
    the model that was driven."""

    campaign: str
    name: str
    stage: StudyName
    state: str
    settings: dict[str, Any]
    vehicle: str | None = None
    ended_at: datetime | None


class StudyPage(Page[Study]):
    """The studies of a campaign's best sets and of its influence map, newest first."""


class FrontObjective(Answer):
    """An objective, in its own units: best and worst value on the front (null without one), and the `reference` of hypervolumes.

    `aggregate`: mean, min, max or `quantile Q` over the scenarios.
    """

    name: str
    unit: str
    direction: str
    aggregate: str
    scenarios: dict[str, float]
    """Weights, of sum 1."""
    tolerance: float
    reference: float
    best: float | None
    worst: float | None


class FrontGrowth(Answer):
    """The front of all sets up to an iteration; -1: those of other campaigns. `hypervolume` is null for more than three objectives."""

    iteration: int
    hypervolume: float | None
    size: int


class FrontSummary(Answer):
    """The front of a campaign: `evaluated` sets have a value of every objective, `feasible` ones keep all constraints, `size` make the
    front, of which `copied` have a score of a reference. `knee` and `extremes` are ranks in the table; the knee is null without one."""

    objectives: list[FrontObjective]
    constraints: list[str]
    evaluated: int
    feasible: int
    size: int
    copied: int
    knee: int | None
    extremes: dict[str, int] = Field(default_factory=dict)
    hypervolume: float | None
    growth: list[FrontGrowth]


class ValuePair(Answer):
    """Two values of the same thing; `gain`: by how much the second is better, null if neither is."""

    name: str
    first: Score | str | None
    second: Score | str | None
    gain: float | None = None


class TradeOff(Answer):
    """Two sets of a front, by rank: all objectives, scores by scenario, and the parameters that differ. `distance`: root mean square, in
    shares of the searched ranges; `text`: what the second gains and costs, a line per objective."""

    first: int
    second: int
    objectives: list[ValuePair]
    scores: list[ValuePair]
    parameters: list[ValuePair]
    distance: float
    text: list[str]

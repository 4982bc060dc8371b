"""Answers about studies of a campaign's results, and about the trust that the result deserves."""

from datetime import datetime
from typing import Any, Literal, get_args

from drivecal.contracts.campaign import Answer, Page

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


Light = Literal["green", "amber", "red"]


class Reason(Answer):
    """A reason for a light. `about`: end, confirmation, baseline, map, references, predictions, noise, failures or robustness."""

    light: Light
    about: str
    scenario: str | None = None
    text: str


class TrustAnswer(Answer):
    """The trust that a campaign's result deserves. `light`: that of the gravest of the `reasons`, which comes first; null before the end,
    unless it is red already, and without a search."""

    light: Light | None
    reasons: list[Reason]

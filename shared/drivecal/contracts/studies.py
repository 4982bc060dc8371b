"""Answers about studies of a campaign's results: robustness and validation."""

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

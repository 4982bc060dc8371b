"""Answers about pushed problems."""

from datetime import datetime
from typing import Any

from pydantic import Field

from drivecal.contracts.campaign import Answer, Page


class ProblemHeading(Answer):
    """A pushed problem in a list. `digest`: of its content; `size`: of its archive in bytes; `latest`: whether its name means it."""

    name: str
    digest: str
    size: int
    latest: bool
    created_at: datetime
    links: dict[str, str] = Field(default_factory=dict)


class ProblemPage(Page[ProblemHeading]):
    """Problems, last pushed first."""


class ProblemAnswer(ProblemHeading):
    """A pushed problem: the sections of its `problem.yaml`, checked and with the defaults filled in."""

    description: str
    parameters: dict[str, dict[str, Any]]
    constraints: list[str]
    baseline: dict[str, float | str] | None
    simulator: dict[str, Any]
    scenarios: dict[str, dict[str, Any]]
    measures: dict[str, str]
    """Units by measure."""
    failures: list[str]
    series: dict[str, str]
    """Units by time series."""
    scores: dict[str, dict[str, Any]]

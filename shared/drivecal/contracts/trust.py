"""Answers about the trust that a campaign's result deserves."""

from typing import Literal

from drivecal.contracts.campaign import Answer

Light = Literal["green", "amber", "red"]


class Reason(Answer):
    """A reason for a light. `about`: end, constraints, confirmation, baseline, map, references, predictions, noise, failures or
    robustness."""

    light: Light
    about: str
    scenario: str | None = None
    text: str


class TrustAnswer(Answer):
    """The trust that a campaign's result deserves. `light`: that of the gravest of the `reasons`, which comes first; null before the end,
    unless it is red already, and without a search."""

    light: Light | None
    reasons: list[Reason]

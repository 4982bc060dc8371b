"""Messages of a campaign's event stream; `drivecal.domain.events` lists the kinds."""

from datetime import datetime
from typing import Any

from pydantic import Field

from drivecal.contracts.campaign import Answer, CellsByStage, Progress, Seconds

PROGRESS = "progress"
"""The name of what is sent between events, without an id: how far the campaign is now."""


class CampaignEvent(Answer):
    """Something that happened to a campaign; what more it holds depends on its `kind`.

    `id` is what the stream can be resumed after; null for what is not stored: that the dispatcher is silent, and that it speaks again.
    """

    id: int | None = None
    kind: str
    campaign: str
    at: datetime
    text: str = ""
    """The event as a line for readers; its wording may change."""
    data: dict[str, Any] = Field(default_factory=dict)


class CampaignProgress(CellsByStage):
    """Fields of `Campaign` that change while it runs."""

    state: str
    requested_action: str | None = None
    degraded: str | None = None
    waiting: str | None = None
    stage: str | None = None
    iteration: int | None = None
    """Iteration of the search, counted from 0."""
    progress: Progress = Progress()
    seconds: Seconds = Seconds()

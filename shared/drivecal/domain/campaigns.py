"""States and stages of a campaign, and the effects of pausing, resuming and cancelling it. Pure."""

from datetime import datetime
from enum import StrEnum
from typing import Any, Literal

from drivecal.domain.errors import ConflictError
from drivecal.domain.events import EventKind


class CampaignState(StrEnum):
    """State of a campaign, from `queued` to one of three final states."""

    QUEUED = "queued"
    RUNNING = "running"
    PAUSED = "paused"
    CANCELLING = "cancelling"
    CANCELLED = "cancelled"
    SUCCEEDED = "succeeded"
    FAILED = "failed"

    @property
    def ended(self) -> bool:
        """True if the state is final."""
        return self in {CampaignState.CANCELLED, CampaignState.SUCCEEDED, CampaignState.FAILED}


class StageName(StrEnum):
    """Stages: `claims` first, then in this order. Append only: positions are stored. Single evaluations are stored as `calibration`."""

    SENSITIVITY = "sensitivity"
    CALIBRATION = "calibration"
    ROBUSTNESS = "robustness"
    VALIDATION = "validation"
    CLAIMS = "claims"


Action = Literal["cancel", "pause", "resume"]


def change(
    campaign_id: str, state: CampaignState, asked: Action | None, action: Action, *, has_started: bool, now: datetime
) -> tuple[EventKind, dict[str, Any]] | None:
    """Returns the event to record and the columns to change, or None if `action` changes nothing or was requested already.

    `asked`: the earlier request that the dispatcher has not carried out yet. The dispatcher carries out what a started campaign is asked
    for, unless that only takes back the earlier request. Raises ConflictError if the campaign has ended or is about to be cancelled.
    """
    if state.ended:
        if action == "cancel" and state is CampaignState.CANCELLED:
            return None
        raise ConflictError(f"campaign {campaign_id} has ended ({state}): it is too late to {action} it")
    cancelling = state is CampaignState.CANCELLING or asked == "cancel"
    if cancelling and action != "cancel":
        raise ConflictError(f"campaign {campaign_id} is being cancelled: it is too late to {action} it")
    match action:
        case "cancel" if not cancelling:
            if has_started:
                return EventKind.CANCELLING, {"requested_action": "cancel"}
            ended = {"state": CampaignState.CANCELLED, "ended_at": now, "requested_action": None, "waiting": None}
            return EventKind.CANCELLED, ended
        case "pause" if state is CampaignState.QUEUED:
            return EventKind.PAUSED, {"state": CampaignState.PAUSED}
        case "pause" if state is CampaignState.RUNNING and asked != "pause":
            return EventKind.PAUSING, {"requested_action": "pause"}
        case "pause" if asked == "resume":
            return EventKind.PAUSED, {"requested_action": None}
        case "resume" if state is CampaignState.PAUSED and not has_started:
            return EventKind.QUEUED, {"state": CampaignState.QUEUED}
        case "resume" if state is CampaignState.PAUSED and asked != "resume":
            return EventKind.RESUMING, {"requested_action": "resume"}
        case "resume" if asked == "pause":
            return EventKind.RESUMED, {"requested_action": None}
    return None

"""What is wrong with campaigns that the dispatcher itself cannot tell: that it is silent."""

from __future__ import annotations

from datetime import datetime, timedelta

from drivecal.domain.campaigns import CampaignState
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.glances import Glance

SILENT_SECONDS = 4.0
"""A dispatcher that has not spoken for longer does not work; it speaks every second."""
STEPS = (
    (SILENT_SECONDS, "4 s"),
    (10, "10 s"),
    (30, "30 s"),
    (60, "a minute"),
    (300, "5 minutes"),
    (900, "15 minutes"),
    (3600, "an hour"),
)
"""So coarse that what is said about a silence stays the same for a while, and with it the ETag."""
NOT_STARTED = "no dispatcher is running"


def silence(heartbeat_at: datetime | None, now: datetime) -> str | None:
    """What to say of a dispatcher that was last heard of at `heartbeat_at`; None where it works."""
    if heartbeat_at is None:
        return NOT_STARTED
    silent = (now - heartbeat_at) / timedelta(seconds=1)
    said = None
    for seconds, words in STEPS:
        if silent > seconds:
            said = f"the dispatcher has been silent for more than {words}"
    return said


def degraded(campaign: Glance | StoredCampaign, silent: str | None) -> str | None:
    """Why a campaign goes on more slowly, or not at all: what `silence` says, and what the dispatcher said of it last."""
    waits = not campaign.state.ended and (campaign.state is not CampaignState.PAUSED or campaign.requested_action is not None)
    if silent is None or not waits:
        return campaign.degraded
    return silent if campaign.degraded is None else f"{silent}; it last said: {campaign.degraded}"

"""States and stages of a campaign."""

from enum import StrEnum


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

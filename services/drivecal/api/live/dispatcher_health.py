"""Health of the dispatcher as other processes see it: its silence, its readiness, and remedies."""

from dataclasses import dataclass
from datetime import datetime, timedelta

from drivecal.domain.campaigns import CampaignState
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.processes import StoredProcess
from drivecal.storage.revision_queries import CampaignRevision

SILENT_SECONDS = 4.0
"""Silence of a dispatcher that does not work; it sends a heartbeat every second."""
GONE_AFTER_SECONDS = 10.0
"""Silence after which a dispatcher counts as gone. Before (SILENT_SECONDS) it is only reported: it may be planning, or starting again."""
STEPS = (
    (SILENT_SECONDS, "4 s"),
    (10, "10 s"),
    (30, "30 s"),
    (60, "a minute"),
    (300, "5 minutes"),
    (900, "15 minutes"),
    (3600, "an hour"),
)
"""Coarse steps, so that the message about a silence, and with it the ETag, stays the same for a while."""
NOT_STARTED = "no dispatcher is running"
AHEAD = "the dispatcher's last heartbeat is later than this clock: a clock was set back, or those of two machines differ"
"""Said of a heartbeat that is further ahead than GONE_AFTER_SECONDS. It would hide the end of a dispatcher until the clock reaches it."""


def silence(heartbeat_at: datetime | None, now: datetime) -> str | None:
    """Returns a message about a dispatcher whose last heartbeat was at `heartbeat_at`, or None if it works."""
    if heartbeat_at is None:
        return NOT_STARTED
    silent = (now - heartbeat_at) / timedelta(seconds=1)
    if silent < -GONE_AFTER_SECONDS:
        return AHEAD
    longest = next((words for seconds, words in reversed(STEPS) if silent > seconds), None)
    return None if longest is None else f"the dispatcher has been silent for more than {longest}"


def degraded(campaign: CampaignRevision | StoredCampaign, silent: str | None) -> str | None:
    """Returns why a campaign is slowed down or stopped: the message of `silence`, and the dispatcher's last one."""
    waits = not campaign.state.ended and (campaign.state is not CampaignState.PAUSED or campaign.requested_action is not None)
    if silent is None or not waits:
        return campaign.degraded
    return silent if campaign.degraded is None else f"{silent}; it last said: {campaign.degraded}"


@dataclass(frozen=True, slots=True)
class Judgement:
    """`problems` are sentences; with one, work may still go on (`ready`). `silent`: the dispatcher counts as gone."""

    ready: bool
    problems: tuple[str, ...] = ()
    silent: bool = False


def silent_seconds(dispatcher: StoredProcess, now: datetime) -> float:
    """Returns the time since the last heartbeat; how far it is ahead, if that is more than GONE_AFTER_SECONDS; else 0."""
    age = _age(dispatcher, now)
    return -age if age < -GONE_AFTER_SECONDS else max(0.0, age)


def _age(dispatcher: StoredProcess, now: datetime) -> float:
    return (now - dispatcher.heartbeat_at) / timedelta(seconds=1)


def judge(dispatcher: StoredProcess | None, now: datetime) -> Judgement:
    """Judges the service, which is ready with a dispatcher that is not silent and at least one started worker."""
    if dispatcher is None:
        reason = "no dispatcher has started yet; `drivecal serve` starts one, and in a cluster its log says what keeps it"
        return Judgement(ready=False, problems=(reason,), silent=True)
    problems = []
    silent = _age(dispatcher, now)
    gone = abs(silent) > GONE_AFTER_SECONDS
    if gone and silent < 0:
        problems.append(f"{AHEAD}; set them alike")
    elif silent > SILENT_SECONDS:
        problems.append(
            f"the dispatcher has been silent for {silent:.0f} s; `drivecal serve`, or the guard of its container, starts it again, and its"
            " log says why"
        )
    if said := dispatcher.detail.get("degraded"):
        problems.append(f"it last said: {said}" if problems else str(said))
    if gone:
        return Judgement(ready=False, problems=tuple(problems), silent=True)
    states = [worker.get("state") for worker in dispatcher.detail.get("workers", [])]
    started = any(state != "starting" for state in states)
    if not started and not problems:
        starting = "its worker is starting" if len(states) == 1 else f"its {len(states)} workers are starting"
        problems.append(f"the dispatcher has no worker yet: {starting if states else 'wait for it to start them'}")
    return Judgement(ready=started, problems=tuple(problems))

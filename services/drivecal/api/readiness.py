"""Whether campaigns are carried out, and if not, why and what to do: from what the dispatcher last said, and when."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

from drivecal.api.silence import SILENT_SECONDS
from drivecal.storage.processes import StoredProcess

GONE_AFTER_SECONDS = 10.0
"""A dispatcher that has been silent for longer counts as gone. Earlier (SILENT_SECONDS) it is only told of: it may have planned a large
population meanwhile, or be starting again."""


@dataclass(frozen=True, slots=True)
class Judgement:
    """`problems` are sentences; with one, work may still go on (`ready`). `silent`: the dispatcher counts as gone."""

    ready: bool
    problems: tuple[str, ...] = ()
    silent: bool = False


def silent_seconds(dispatcher: StoredProcess, now: datetime) -> float:
    """Since when nothing was heard of the dispatcher, never negative: the clocks of two machines may differ."""
    return max(0.0, (now - dispatcher.heartbeat_at) / timedelta(seconds=1))


def judge(dispatcher: StoredProcess | None, now: datetime) -> Judgement:
    """Ready is who can have a campaign simulated: a dispatcher that speaks, with at least one worker that has started."""
    if dispatcher is None:
        reason = "no dispatcher has started yet; `drivecal serve` starts one, and in a cluster its log says what keeps it"
        return Judgement(ready=False, problems=(reason,), silent=True)
    problems = []
    silent = silent_seconds(dispatcher, now)
    if silent > SILENT_SECONDS:
        problems.append(
            f"the dispatcher has been silent for {silent:.0f} s; it is started again by itself, and its log says why"
        )
    if dispatcher.detail.get("degraded"):
        problems.append(str(dispatcher.detail["degraded"]))
    if silent > GONE_AFTER_SECONDS:
        return Judgement(ready=False, problems=tuple(problems), silent=True)
    states = [worker.get("state") for worker in dispatcher.detail.get("workers", [])]
    started = any(state != "starting" for state in states)
    if not started and not problems:
        starting = "its worker is starting" if len(states) == 1 else f"its {len(states)} workers are starting"
        problems.append(f"the dispatcher has no worker yet: {starting if states else 'wait for it to start them'}")
    return Judgement(ready=started, problems=tuple(problems))

"""What events say on the screen, one line each."""

from __future__ import annotations

from typing import Any

from drivecal.contracts.events import CampaignEvent
from drivecal.domain.events import EventKind

ASKED = {
    "pause": "asked to pause: what runs at workers is finished first",
    "resume": "asked to go on: the dispatcher takes it up",
    "cancel": "asked to end: what runs at workers is finished first, and kept",
}
"""What is the case between a request and its execution."""


def event_text(event: CampaignEvent) -> str | None:
    """An event as a line; None for those that the progress shows as well, and for those of a newer server."""
    data = event.data
    match event.kind:
        case EventKind.STAGE:
            return f"the {data.get('stage')} stage begins: at most {_count(data, 'cells')} cells"
        case EventKind.PHASE:
            counts = f"{_count(data, 'requested')} cells so far, {_count(data, 'simulated')} simulated"
            return f"the phase {data.get('name')} is finished: {counts}"
        case EventKind.INFLUENCE_MAP:
            influential = data.get("influential") or {}
            listed = "; ".join(f"{scenario} {' '.join(names) or '-'}" for scenario, names in influential.items())
            return f"influence map {data.get('id')}: what matters is {listed}"
        case EventKind.BEST:
            scores = "  ".join(f"{scenario} {score}" for scenario, score in (data.get("scores") or {}).items())
            return f"new best {data.get('objective', 0.0):.4f} in iteration {data.get('iteration', 0) + 1}: {scores}"
        case EventKind.BASELINE:
            return f"the baseline has the objective {data.get('objective', 0.0):.4f}"
        case EventKind.REUSE_STOPPED:
            wrong = f"{_count(data, 'wrong')} of {_count(data, 'audited')} audited cells were wrong"
            return f"reuse in {data.get('scenario')} was stopped: {wrong}"
        case EventKind.RUN:
            best = "nothing" if data.get("best") is None else f"{data['best']:.4f}"
            return f"run {_count(data, 'ended')} of {_count(data, 'of')} has ended ({data.get('state')}): {data.get('name')}: best {best}"
        case EventKind.NOTE:
            return f"note: {data.get('text')}"
        case EventKind.DEGRADED:
            return f"degraded: {data.get('reason')}"
        case EventKind.RECOVERED:
            return "recovered: it goes on as usual"
        case EventKind.PAUSING:
            return ASKED["pause"]
        case EventKind.RESUMING:
            return ASKED["resume"]
        case EventKind.CANCELLING:
            return ASKED["cancel"]
        case EventKind.PAUSED:
            return "paused; `drivecal resume` lets it go on"
        case EventKind.RESUMED:
            return "it goes on"
    return None


def _count(data: dict[str, Any], name: str) -> str:
    return f"{data.get(name, 0):,}"

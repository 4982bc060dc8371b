"""Kinds of events of a campaign, and their texts."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from drivecal.domain.scales import objective_text, score_text


class EventKind(StrEnum):
    """Kind of an event. Names are stored and sent to clients: add names, never rename them.

    The first ten kinds report the campaign's state, which their data holds as `state`.
    """

    QUEUED = "queued"
    RUNNING = "running"
    PAUSING = "pausing"
    """Pause requested; workers finish their running cells first."""
    PAUSED = "paused"
    RESUMING = "resuming"
    """Resumption requested."""
    RESUMED = "resumed"
    CANCELLING = "cancelling"
    """Cancellation requested; cells that run are finished first."""
    CANCELLED = "cancelled"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    """`error`: the reason."""

    DEGRADED = "degraded"
    """The campaign is slowed down or stopped for now; `reason`: the cause."""
    RECOVERED = "recovered"
    """The cause of the last `degraded` event is gone."""
    STALLED = "stalled"
    """The campaign has had no result for `minutes`, and its cells wait: `reason` says why."""
    STAGE = "stage"
    """A `stage` begins, with at most `cells` cells."""
    PHASE = "phase"
    """A `phase` of the sensitivity stage is finished: its `name` and the stage's cells so far."""
    INFLUENCE_MAP = "influence_map"
    """The sensitivity stage stored its map: `id`, and the `influential` parameters by scenario."""
    GENERATION = "generation"
    """An `iteration` (from 0) of the calibration stage is finished: its cells by outcome; `best`, `mean`, worst (`minimum`) objective."""
    BEST = "best"
    """A new best parameter set, either better than all before or best after seemingly better sets were simulated.

    Data: `objective`, `parameters`, `scores`, `alternatives` with the same objective, and the `iteration` of origin.
    """
    BASELINE = "baseline"
    """The result of the user's own parameter set is known: `objective`, `scores`."""
    LOT_REJECTED = "lot_rejected"
    """The first lot of references in a `scenario` was rejected. Until then `wrong` of the `audited` cells were wrong."""
    NOTE = "note"
    """A remark for the reader, as `text`."""


ASKED = {
    "pause": "pausing: workers finish their running cells first",
    "resume": "resuming: the dispatcher continues it",
    "cancel": "cancelling: cells that run are finished first, and results are kept",
}
"""Texts of a requested action until it takes effect."""

_TEXTS: dict[str, str] = {
    EventKind.QUEUED: "queued",
    EventKind.RUNNING: "started",
    EventKind.PAUSING: ASKED["pause"],
    EventKind.PAUSED: "paused; `drivecal resume` continues it",
    EventKind.RESUMING: ASKED["resume"],
    EventKind.RESUMED: "resumed",
    EventKind.CANCELLING: ASKED["cancel"],
    EventKind.CANCELLED: "cancelled; finished results are kept",
    EventKind.SUCCEEDED: "succeeded",
    EventKind.FAILED: "failed: {error}",
    EventKind.DEGRADED: "degraded: {reason}",
    EventKind.RECOVERED: "recovered",
    EventKind.STALLED: "no result for {minutes} minutes: {reason}",
    EventKind.STAGE: "stage {stage} begins: at most {cells:,} cells",
    EventKind.PHASE: "phase {name} finished: {requested:,} cells so far, {simulated:,} simulated",
    EventKind.INFLUENCE_MAP: "influence map {id}; influential: {influential}",
    EventKind.GENERATION: "iteration {iteration}: best {best}, mean {mean}",
    EventKind.BEST: "new best {objective} in iteration {iteration}{violation}: {scores}",
    EventKind.BASELINE: "baseline: objective {objective}",
    EventKind.LOT_REJECTED: "a lot of references rejected in {scenario} and simulated: {wrong:,} of {audited:,} audited cells were wrong",
    EventKind.NOTE: "note: {text}",
}


def event_text(kind: str, data: Mapping[str, Any]) -> str:
    """Returns an event as a line for readers; of another version's kind or data, the name of the kind."""
    name_of_kind = kind.replace("_", " ")
    text = _TEXTS.get(kind, name_of_kind)
    try:
        words = _Words({name: _word(name, value) for name, value in data.items() if value is not None})
        if words.get("violation") and data.get("undecided"):
            words["violation"] = ", not known to keep its rates"
        return text.format_map(words).removesuffix(", mean -")
    except (AttributeError, TypeError, ValueError):
        return name_of_kind


class _Words(dict[str, Any]):
    """Words of a line; an unknown figure is a dash."""

    def __missing__(self, name: str) -> _Unknown:
        return _Unknown()


class _Unknown:
    def __format__(self, specification: str) -> str:
        return "-"


def _word(name: str, value: Any) -> Any:
    if name == "iteration":
        return value + 1  # readers count from 1
    if name == "violation":
        return f", which breaks constraints by {100 * value:.1f} %" if value > 0 else ""
    if name in {"best", "mean", "objective"}:
        return objective_text(value)
    if name == "influential":
        return "; ".join(f"{scenario} {' '.join(names) or '-'}" for scenario, names in value.items())
    if name == "scores":
        return "  ".join(f"{scenario} {score_text(score)}" for scenario, score in value.items())
    return value
